"""Build a `Scene` from posed photographs and a split; every loader of real photographs ends here."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple, Self

from ...contract.checks.scene import validate
from ...contract.scene import Fact, PointCloud, Scene, View
from ...errors import SceneError
from ..progress.parallel import in_parallel
from .copies import Impression
from .decoder import QUARTER_TURNS, Decoder, stored_form, stored_size
from .lens import Lens, import_pycolmap, undistort
from .masks.reading import points_in_training, read_mask, report_masks
from .reading import existing_image, find_image, list_images

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from core_rasterizer import Camera

    from .bounds import Bounds
    from .decoder import Pixels, Size

FAR_AWAY = 50.0
"""Distance of a camera from the median centre, in medians of these distances, that no capture has."""
MIN_TO_JUDGE = 4
"""Cameras that are needed to say that one of them is far away."""
_MAX_PAIRS = 6
_FINER = 2
"""Photographs are undistorted at this multiple of their size, because bilinear resampling blurs them."""
_TURNED = "are turned by their EXIF data, because their cameras only fit then"
_AS_STORED = "have an EXIF orientation; their cameras are those of the pixels as stored"


_log = logging.getLogger("stereogs.photos")


@dataclass(frozen=True, eq=False)
class PosedPhoto:
    """An image file with its camera.

    Args:
        name, path: Name of the view, path of the image file; its suffix may differ from the actual one.
        world_to_camera: `[4, 4]` float64, OpenCV axes.
        lens: Lens at the size in the camera file; it is scaled to the image's size.
        where: Location in the camera file, for error messages.
        mask: Path of an image that marks the pixels that count in metrics, see `read_mask`.
        white_mask: Only pure white counts in it.
        mask_trains: Only the marked pixels train, too.
    """

    name: str
    path: Path
    world_to_camera: NDArray[np.float64]
    lens: Lens
    where: str
    mask: Path | None = None
    white_mask: bool = False
    mask_trains: bool = False


def usable_photos(
    photos: Sequence[PosedPhoto],
    where: str,
    fix: str = "restore them, or correct their names there",
) -> list[int]:
    """Return the indices of photographs whose file exists and whose camera is near the others.

    A warning names those that are left out; a line, pictures beside them without a camera.

    Raises:
        SceneError: more than half of the photographs are missing.
    """
    files = [existing_image(photo.path) for photo in photos]
    found = [index for index, file in enumerate(files) if file is not None]
    missing = [photos[index].path.name for index, file in enumerate(files) if file is None]
    if 2 * len(missing) > len(photos):
        raise SceneError(
            f"{len(missing)} of {len(photos)} photographs are missing, for example {missing[0]}",
            where=where,
            fix=fix,
        )
    if missing:
        _log.warning(
            "%d of %d photographs are missing and left out: %s",
            *(len(missing), len(photos), ", ".join(missing)),
        )
    known = {*files, *(photo.mask for photo in photos)}
    folders = {file.parent for file in files if file}
    beside = (path for folder in folders for path in list_images(folder))
    if others := sorted(path.name for path in beside if path not in known):
        _log.info(
            "pictures without a camera are not used: %d, for example %s", len(others), others[0]
        )
    distances = _distances([photos[index].world_to_camera for index in found])
    for index, distance in zip(found, distances, strict=True):
        if distance > FAR_AWAY:
            _log.warning(
                "%s is left out: its camera is %.0f times as far from the others as they are from each "
                "other; check its pose",
                *(photos[index].path.name, distance),
            )
    return [k for k, distance in zip(found, distances, strict=True) if distance <= FAR_AWAY]


def _distances(poses: Sequence[NDArray[np.float64]]) -> list[float]:
    """Return each camera's distance from the median camera centre, in medians of these distances."""
    import numpy as np

    if len(poses) < MIN_TO_JUDGE:
        return [0.0] * len(poses)
    with np.errstate(all="ignore"):  # numbers that are not finite are refused later
        centers = np.stack([-pose[:3, :3].T @ pose[:3, 3] for pose in poses])
        distances = np.linalg.norm(centers - np.median(centers, axis=0), axis=1)
        usual = float(np.median(distances))
    return [float(d) / usual if usual > 0 and np.isfinite(d) else 0.0 for d in distances]


def _warn_of_copies(train: Sequence[View], test: Sequence[View]) -> None:
    """Warn of test views whose photograph is a copy of a training view's: they score what was trained."""
    seen = in_parallel(_impression, [*train, *test])
    trained, pairs = list(zip(train, seen, strict=False)), []
    for view, impression in zip(test, seen[len(train) :], strict=True):
        copy = next((one.name for one, other in trained if impression.is_copy_of(other)), None)
        if copy is not None:
            pairs.append(f"{view.name} of {copy}")
    if pairs:
        shown = ", ".join(pairs[:_MAX_PAIRS]) + (", ..." if len(pairs) > _MAX_PAIRS else "")
        _log.warning(
            "WARNING: %d of %d test views are copies of training views, so their scores are not those of new "
            "views: %s\n  fix    remove one of each two from the data set, or train on all: --test-every 0",
            *(len(pairs), len(test), shown),
        )


def _impression(view: View) -> Impression:
    from PIL import Image

    from ..drawing import to_bytes

    return Impression.of(Image.fromarray(to_bytes(view.image)))


class _LoadedView(NamedTuple):
    """A view, and the rules of its mask and of its EXIF orientation in words, empty where none is needed."""

    view: View
    mask_rule: str
    turn_rule: str


def _load_view(photo: PosedPhoto, decoder: Decoder) -> _LoadedView:
    import numpy as np
    import torch

    path = find_image(photo.path)
    posed = not decoder.upright
    decoder, orientation = _decoder_of(photo, decoder)
    pixels, alpha = decoder.read(path), decoder.read_alpha(path)
    height, width = pixels.shape[:2]
    distorted = photo.lens.resized(width, height, photo.where)
    lens, pixels = _straight(distorted, pixels, photo.where)
    mask, rule = None, ""
    if photo.mask is not None:
        marked, rule = read_mask(
            *(photo.mask, (width, height)),
            white_only=photo.white_mask,
            orientation=orientation if decoder.upright else 1,
        )
        mask = torch.from_numpy(_straight(distorted, marked, photo.where)[1] == 255)
    if alpha is not None:
        _, alpha = _straight(distorted, alpha, photo.where)
    view = View(
        name=photo.name,
        camera=lens.camera(photo.world_to_camera, photo.where),
        image=torch.from_numpy(pixels.astype(np.float32) / 255),
        mask=mask,
        alpha=None if alpha is None else torch.from_numpy(alpha.astype(np.float32) / 255),
        weights=mask.float() if mask is not None and photo.mask_trains else None,
    )
    turn = ""
    if posed and orientation != 1:
        turn = _TURNED if decoder.upright else _AS_STORED
    return _LoadedView(view, rule, turn)


def _decoder_of(photo: PosedPhoto, decoder: Decoder) -> tuple[Decoder, int]:
    """The decoder, for `_FINER` times the size if the photograph must be undistorted; its EXIF orientation.

    Cameras belong to the pixels as stored, as COLMAP's do, unless they only fit those turned by EXIF.
    """
    size, orientation = stored_form(find_image(photo.path))
    photo.lens.check(photo.where)
    if orientation in QUARTER_TURNS and not photo.lens.fits(*size):
        decoder = replace(decoder, upright=decoder.upright or photo.lens.fits(*size[::-1]))
    if photo.lens.is_pinhole:
        return decoder, orientation

    def finer(width: int, height: int) -> Size:
        width, height = decoder.size(width, height)
        return _FINER * width, _FINER * height

    return replace(decoder, size=finer, resize_filter="lanczos"), orientation


def _straight(lens: Lens, pixels: Pixels, where: str) -> tuple[Lens, Pixels]:
    """Undistort a photograph read for it, and average blocks of `_FINER` x `_FINER` pixels."""
    import numpy as np
    from PIL import Image

    if lens.is_pinhole:
        return lens, pixels
    lens, pixels = undistort(lens, pixels, where)
    height, width = (side // _FINER for side in pixels.shape[:2])
    covered = Image.fromarray(pixels[: _FINER * height, : _FINER * width])
    fx, fy, cx, cy = (value / _FINER for value in (lens.fx, lens.fy, lens.cx, lens.cy))
    return Lens(fx, fy, cx, cy, width, height), np.asarray(covered.reduce(_FINER))


@dataclass(frozen=True, eq=False)
class LoadedPhotos:
    """Photographs of a scene with their views.

    Args:
        photos, views: In the same order, training views first.
        decoder: Decoder that read them.
        train, test: Indices of the photographs in the data set.
    """

    photos: Sequence[PosedPhoto]
    views: Sequence[View]
    decoder: Decoder
    train: list[int]
    test: list[int]

    @classmethod
    def load(
        cls, photos: Sequence[PosedPhoto], decoder: Decoder, train: list[int], test: list[int]
    ) -> Self:
        """Decode, undistort and check photographs in parallel, ordered as `train` followed by `test`.

        Raises:
            SceneError: An image or mask cannot be read, or does not match its camera.
        """
        if not all(photo.lens.is_pinhole for photo in photos):
            import_pycolmap()  # here, because threads cannot restore the handler of SIGTERM
        loaded = in_parallel(lambda photo: _load_view(photo, decoder), photos, stage="reading")
        views = [read.view for read in loaded]
        report_masks([photo.mask for photo in photos], views, [read.mask_rule for read in loaded])
        for rule in sorted({read.turn_rule for read in loaded} - {""}):
            names = [read.view.name for read in loaded if read.turn_rule == rule]
            _log.info(
                "%d of %d photographs %s: %s", len(names), len(photos), rule, ", ".join(names)
            )
        _warn_of_copies(views[: len(train)], views[len(train) :])
        return cls(photos, views, decoder, train, test)

    @property
    def training_cameras(self) -> list[Camera]:
        """Cameras of the training views, for `estimate_bounds`."""
        return [view.camera for view in self.views[: len(self.train)]]

    def report_transparency(self) -> None:
        """Log which photographs have transparent pixels, and what is behind them."""
        clear = [
            view.name
            for view in self.views
            if view.alpha is not None and bool((view.alpha < 1).any())
        ]
        if clear:
            _log.info(
                "transparent pixels in %d of %d photographs, %s first, are laid on the background (%s); "
                "masks exclude pixels",
                *(len(clear), len(self.views), clear[0]),
                " ".join(f"{channel:g}" for channel in self.decoder.background),
            )

    def require_one_size(self) -> None:
        """Refuse views of different sizes, for formats that require equal sizes.

        Raises:
            SceneError: Names the first view that differs from the most frequent size.
        """
        sizes = [(view.camera.width, view.camera.height) for view in self.views]
        usual = max(sizes, key=sizes.count)
        for photo, size in zip(self.photos, sizes, strict=True):
            if size != usual:
                raise SceneError(
                    f"the image is {size[0]}x{size[1]}, the others are {usual[0]}x{usual[1]}",
                    where=str(photo.path),
                    fix="resize all photographs of the scene in the same way",
                )

    def split_facts(self, rule: str, available: int | None = None) -> tuple[Fact, ...]:
        """Return facts about the split.

        Args:
            rule: Description of the rule, see `SplitSettings.split`.
            available: Number of photographs with cameras, used or not; None if the format does not tell.
        """
        train, test = tuple(self.train), tuple(self.test)
        facts = (
            Fact("split", rule),
            Fact("train_photographs", train),
            Fact("test_photographs", test),
        )
        if available is None:
            return facts
        text = f"{available}, {available - len(train) - len(test)} of them left out by the split"
        return (Fact("photographs", available, text, affects_scores=False), *facts)

    def scene(
        self,
        format_name: str,
        folder: Path,
        bounds: Bounds,
        points: PointCloud | None,
        facts: Iterable[Fact],
    ) -> Scene:
        """Return the validated scene, named after its folder, with the decoder's background and more facts.

        Raises:
            SceneError: `validate` refuses the scene.
        """
        count, first = len(self.train), self.photos[0]
        train = tuple(self.views[:count])
        masked = any(view.weights is not None for view in self.views)
        common = (
            Fact("format", format_name),
            Fact("source", first.path.parent.name),
            Fact("changed", "; ".join(_changes(first, self.decoder)) or "nothing"),
        )
        scene = Scene(
            name=folder.resolve().name,
            train=train,
            test=tuple(self.views[count:]),
            bounds=bounds,
            points=points_in_training(points, train),
            background=self.decoder.background,
            facts=(*common, *facts, *[Fact("masks", "training and scores")][: int(masked)]),
        )
        return validate(scene)


def _changes(photo: PosedPhoto, decoder: Decoder) -> list[str]:
    """Describe how the decoder and `_straight` change a photograph."""
    own, _ = _decoder_of(photo, decoder)
    stored = stored_size(find_image(photo.path), upright=own.upright)
    size = decoder.size(*stored)
    changes = []
    if size != stored:
        changes.append(
            f"resized from {stored[0]}x{stored[1]} to {size[0]}x{size[1]} "
            f"with the {own.resize_filter} filter"
        )
    if not photo.lens.is_pinhole:
        changes.append(
            f"undistorted ({photo.lens.model}) at {_FINER} times this size and cropped to what was seen, "
            "by pycolmap, bilinear"
        )
    return changes
