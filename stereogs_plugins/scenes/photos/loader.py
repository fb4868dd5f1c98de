"""`photos`: a folder of photographs without cameras, which COLMAP estimates."""

from __future__ import annotations

import logging
import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from pydantic import Field

from registry import Fact, Scene, SceneError, SceneLoader, View
from registry.toolkit import counted
from registry.toolkit.photos import (
    ColmapModel,
    Decoder,
    LoadedPhotos,
    PosedPhoto,
    ResizeFilter,
    SplitSettings,
    estimate_bounds,
    longest_side,
)

from .picture_files import (
    COMPANION,
    is_picture_folder,
    left_out_lines,
    readable_pictures,
    reason_lines,
)

if TYPE_CHECKING:
    from torch import Tensor

    from registry.priors import PosedDepthPrior

    from .disconnected import LargestGroup
    from .found_cameras import FoundCameras
    from .picture_files import LeftOut
    from .unposed_photos import UnposedPhoto

CAMERA_PRIOR = "posed_depth"
"""Capability of priors that estimate cameras."""
_SMALLEST = 600
"""`matching_size` at least when time is short."""
_PER_PHOTO, _PER_PIXEL = 3.2, 3.8e-6
"""CPU seconds for a photograph's cameras: 43.6 for five of 1200x900 pixels, 23.0 for five of 600x450."""
_log = logging.getLogger("stereogs.photos")


class PhotosSettings(SplitSettings):
    path: Path
    """Path of the folder of photographs."""
    test_every: int | None = Field(0, ge=0)
    """Every N-th photograph of the sorted list is a test view, starting with the first; 0 gives no test
    views. null means 8, and 0 for fewer than eight photographs."""
    require_all_photos: bool = False
    """Raise an error if a photograph does not connect to the others; false leaves it out with a warning."""
    max_size: int = Field(800, ge=16)
    """Longer side of the training photographs after resizing, in pixels."""
    resize_filter: ResizeFilter = "bicubic"
    """Pillow filter for resizing. Distorted photographs use `lanczos`."""
    share_lens: bool = True
    """Photographs of one size, camera and focal length (by EXIF) share one lens; false estimates one for
    each, which needs many more photographs."""
    matching_size: int = Field(1200, ge=64)
    """Longer side of the photographs for camera estimation, in pixels."""
    masks: bool = True
    """Exclude pixels where a mask is black from camera estimation, training and scores. The mask of a.jpg is
    a.jpg.png or a.png in a folder masks."""
    cameras: str | None = None
    """Prior with the capability "posed_depth" whose cameras matches refine and check. null finds cameras by
    matches, and tries such a prior of the pipeline for photographs that do not connect."""

    @property
    def priors(self) -> dict[str, str]:
        """The prior that is named, with its capability."""
        return {} if self.cameras is None else {self.cameras: CAMERA_PRIOR}


class PhotosScene(SceneLoader[PhotosSettings]):
    """Estimates the cameras of all photographs, including test views, and undistorts them.

    Photographs that cannot be read or do not connect to the largest group are left out with a warning.

    Cameras are kept in the user's cache folder. Scale and horizon of the world are arbitrary.
    """

    recognized_by: ClassVar[str] = "pictures, and no files of a data set"

    @classmethod
    def priors_of(cls, settings: PhotosSettings) -> dict[str, str]:
        """Return the prior in `cameras`."""
        return settings.priors

    @classmethod
    def recognizes(cls, folder: Path) -> bool:
        """Return True if the folder and its subfolders contain pictures and no files of a data set."""
        return is_picture_folder(folder)

    @classmethod
    def within(cls, settings: PhotosSettings, cpu_seconds: float) -> PhotosSettings:
        """Find cameras in smaller photographs, of at least 600 pixels, unless the cameras are known."""
        from .found_cameras import are_remembered
        from .unposed_photos import read_folder

        if settings.cameras is not None:
            return settings
        given, folder = settings.matching_size, settings.path.expanduser()
        try:
            count = len(readable_pictures(folder)[0])
            if affordable_side(given, max(1, count), cpu_seconds) == given:
                return settings  # without reading the photographs
            found, _ = read_folder(folder, with_masks=settings.masks)
        except SceneError:  # `load` raises it
            return settings
        usual = min(given, max(max(photo.size) for photo in found))
        side = affordable_side(usual, len(found), cpu_seconds)
        if side == usual or are_remembered(found, treatment_of(settings)):
            return settings
        return settings.model_copy(update={"matching_size": side})

    def load(self) -> Scene:
        """Return the scene.

        Raises:
            SceneError: fewer than three photographs are readable or connect, or one does not although
                `require_all_photos` is set; the message lists those that connect and suggests what to
                photograph next.
        """
        from .disconnected import largest_group
        from .unposed_photos import read_folder

        settings = self.settings
        folder = settings.path.expanduser()
        found, other_files = read_folder(folder, with_masks=settings.masks)
        _warn_of_left_out(folder, other_files)
        names = [photo.name for photo in found]
        cameras = self._find_cameras(found)
        try:
            group = largest_group(
                cameras, names, str(folder), require_all=settings.require_all_photos
            )
        except SceneError as error:
            raise _not_confirmed(cameras.prior, error) if cameras.prior else error from None
        _warn_of_disconnected(names, group)
        _warn_of_focal_length(cameras)
        _warn_of_altered(cameras, names)
        model = group.model
        placed = _posed(model, found)
        train, test, rule = settings.split(len(placed), str(folder))
        photos = [placed[index] for index in train + test]
        decoder = Decoder(longest_side(settings.max_size), settings.resize_filter, upright=True)
        _warn_of_transparency(found, decoder)
        _warn_of_grey(found)
        loaded, turned = _turned_upright(LoadedPhotos.load(photos, decoder, train, test))
        tracks = model.tracks()
        tracks.check(len(placed), str(folder))
        points = tracks.seen_by(train)
        bounds = estimate_bounds(loaded.training_cameras, points, str(folder))
        by_exif = sum(photo.focal is not None for photo in found)
        if cameras.reconstruction.ignores_exif:
            _warn_of_exif(group.model, found)
            by_exif = 0
        facts = (
            Fact("cameras", _origin(cameras.prior)),
            Fact("connected", f"{len(placed)} of {len(found)}", affects_scores=False),
            Fact("lenses", len(model.cameras)),
            Fact("turned_upright", sum(photo.turned for photo in found)),
            *([Fact("turned_without_exif", ", ".join(turned))] if turned else ()),
            Fact("focal_lengths_by_exif", by_exif),
            *_facts_of_left_out(folder, other_files, [names[k] for k in group.left_out]),
            *loaded.split_facts(rule, len(placed)),
        )
        return loaded.scene("photos", folder, bounds, points, facts)

    def _find_cameras(self, found: list[UnposedPhoto]) -> FoundCameras:
        """Return the cameras from those of the prior that is named, or by matches.

        If matches do not connect all photographs, the pipeline's priors are tried, and the cameras of most
        photographs are returned.
        """
        from registry.priors import PosedDepthPrior

        name = self.settings.cameras
        if name is None:
            best = self._remembered(found, None)
            if best.placed < len(found):
                for prior in self.context.priors(PosedDepthPrior).values():
                    best = max(
                        [best, *self._tried(prior, found)], key=lambda cameras: cameras.placed
                    )
            return best
        known = self.context.priors(PosedDepthPrior)
        if name not in known:
            raise SceneError(
                f"the prior {name!r}, whose cameras the scene begins with, is not installed",
                where=str(self.settings.path),
                fix="install its package; or leave out `cameras`, to find cameras by matches",
            )
        if problem := known[name].refusal(len(found)):
            raise SceneError(
                problem,
                where=str(self.settings.path),
                fix=f"leave out `cameras: {name}`, to find cameras by matches; or use as many photographs",
            )
        return self._remembered(found, known[name])

    def _tried(self, prior: PosedDepthPrior[Any], found: list[UnposedPhoto]) -> list[FoundCameras]:
        """Cameras that begin with those of a prior; none if it does not accept so many photographs."""
        if problem := prior.refusal(len(found)):
            _log.info("%s", problem)
            return []
        cameras = self._remembered(found, prior)
        _log.info(
            "from the cameras of the prior %r, those of %d of %d photographs fit together",
            *(prior.context.name, cameras.placed, len(found)),
        )
        return [cameras]

    def _remembered(
        self, found: list[UnposedPhoto], prior: PosedDepthPrior[Any] | None
    ) -> FoundCameras:
        from registry.priors import identity

        from .found_cameras import remembered_cameras
        from .photogrammetry.structure_from_motion import reconstruct

        settings = self.settings
        decoder = Decoder(longest_side(settings.matching_size), "box", upright=True)
        treatment = treatment_of(settings)
        estimate = None if prior is None else prior.posed_depths
        cameras = remembered_cameras(
            found,
            lambda: treatment if prior is None else f"{treatment} {identity(prior)}",
            lambda empty: reconstruct(found, decoder, settings.share_lens, empty, estimate),
        )
        return cameras._replace(prior=prior)


def affordable_side(side: int, photographs: int, cpu_seconds: float) -> int:
    """Return the longer side at which cameras are found in time, between `_SMALLEST` and `side`."""
    left = max(0.0, cpu_seconds / photographs - _PER_PHOTO)
    return min(side, max(_SMALLEST, int(math.sqrt(left / _PER_PIXEL))))


def treatment_of(settings: PhotosSettings) -> str:
    """What the cameras depend on beside the photographs and a prior."""
    from .photogrammetry.learned_matches import known_files

    networks = [path.name for path in known_files() or ()]
    return f"{settings.matching_size} {settings.share_lens} {networks}"


def _origin(prior: PosedDepthPrior[Any] | None) -> str:
    """Where cameras come from, for the results."""
    if prior is None:
        return "found in the photographs by COLMAP"
    unit = ", in metres" if prior.metric else ""
    return f"of the prior {prior.context.name!r}, refined by matches{unit}"


def _not_confirmed(prior: PosedDepthPrior[Any], error: SceneError) -> SceneError:
    name = prior.context.name
    return SceneError(
        f"matches do not confirm the cameras of the prior {name!r}: {error.what}",
        where=error.where,
        fix=f"leave out `cameras: {name}`, to find cameras by matches; or {error.fix}",
    )


def _posed(model: ColmapModel, found: list[UnposedPhoto]) -> list[PosedPhoto]:
    from .photogrammetry.colmap import image_index

    names = _names(found)
    return [
        PosedPhoto(
            name=names[k],
            path=found[k].path,
            world_to_camera=image.world_to_camera,
            lens=model.lens(image),
            where=str(found[k].path),
            mask=found[k].mask,
            mask_trains=True,
        )
        for _, image in model.images
        for k in [image_index(image.name)]
    ]


def _names(found: list[UnposedPhoto]) -> list[str]:
    """The stem of each file, or its whole path where stems repeat."""
    stems = [photo.path.stem for photo in found]
    return [
        stem if stems.count(stem) == 1 else photo.name.replace("/", "_")
        for photo, stem in zip(found, stems, strict=True)
    ]


def _turned_upright(loaded: LoadedPhotos) -> tuple[LoadedPhotos, list[str]]:
    """Turn photographs on their side or upside down as the others are; also return their names.

    None is turned if these are more than one and more than a quarter of all: in pictures taken straight
    down no side is up.
    """
    import torch

    from registry.toolkit.drawing import quarter_turns, turned, upwards

    views = loaded.views
    up = upwards([view.camera for view in views])
    quarters = [quarter_turns(view.camera, up) for view in views]
    if not 0 < len(views) - quarters.count(0) <= max(1, len(views) // 4):
        return loaded, []

    def upright(view: View, count: int) -> View:
        def rotated(layer: Tensor | None) -> Tensor | None:
            return None if layer is None else torch.rot90(layer, count).contiguous()

        return replace(
            view,
            camera=turned(view.camera, count),
            image=torch.rot90(view.image, count).contiguous(),
            alpha=rotated(view.alpha),
            mask=rotated(view.mask),
            weights=rotated(view.weights),
        )

    names = [view.name for view, count in zip(views, quarters, strict=True) if count]
    _log.warning(
        "on their side or upside down, without EXIF data that say so, and turned as the others are: %s",
        ", ".join(names),
    )
    return replace(loaded, views=[*map(upright, views, quarters)]), names


def _warn_of_transparency(found: list[UnposedPhoto], decoder: Decoder) -> None:
    transparent = [photo.name for photo in found if photo.transparent]
    if transparent:
        color = " ".join(f"{channel:g}" for channel in decoder.background)
        _log.warning(
            "transparent pixels in %d of %d pictures, %s first, are laid on the background (%s)",
            *(len(transparent), len(found), transparent[0], color),
        )


def _warn_of_grey(found: list[UnposedPhoto]) -> None:
    grey = [photo.name for photo in found if photo.grey]
    if 0 < len(grey) < len(found):
        _log.warning(
            "%d of %d photographs are grey, for example %s, and make the scene's colours paler: remove them, "
            "or make all grey",
            *(len(grey), len(found), grey[0]),
        )


def _warn_of_left_out(folder: Path, files: list[LeftOut]) -> None:
    told = sum(file.reason != COMPANION for file in files)
    if told:
        lines = left_out_lines(folder, files)
        _log.warning("%s left out:\n  %s", counted(told, "file"), "\n  ".join(lines))


def _warn_of_disconnected(names: list[str], group: LargestGroup) -> None:
    if group.left_out:
        from .disconnected import PAGE

        advice = f"{group.advice}\nor stop here: --require-all-photos\nmore: {PAGE}"
        _log.warning(
            "WARNING: %d of %d photographs connect; the scene is made of these. Left out:\n%s\n  fix    %s",
            *(len(names) - len(group.left_out), len(names)),
            *("\n".join(reason_lines(group.left_out, names)), advice.replace("\n", "\n         ")),
        )


def _warn_of_focal_length(cameras: FoundCameras) -> None:
    model = cameras.model
    if model is not None and not cameras.reconstruction.pieces[0].focal_is_known:
        lens = model.lens(model.images[0][1])
        _log.warning(
            "the photographs hardly determine the focal length (%.2f times the longer side is used), so the "
            "scene may be stretched in depth; take some from farther to the side, or put their focal length "
            "into EXIF",
            lens.fx / max(lens.width, lens.height),
        )


def _warn_of_altered(cameras: FoundCameras, names: list[str]) -> None:
    altered = cameras.reconstruction.pieces[0].altered
    if altered:
        _log.warning(
            "WARNING: cropped or zoomed, as it seems: %s. Cameras may be wrong, as such lenses are estimated "
            "less exactly: use the whole picture, or remove it",
            ", ".join(names[k] for k in altered),
        )


def _warn_of_exif(model: ColmapModel, found: list[UnposedPhoto]) -> None:
    """Warn, with the photograph whose focal length differs most from the estimated one."""
    from .photogrammetry.colmap import image_index
    from .unposed_photos import equivalent_focal

    focals = []
    for _, image in model.images:
        photo, lens = found[image_index(image.name)], model.lens(image)
        if photo.focal is not None:
            estimated = lens.fx / max(lens.width, lens.height)
            focals.append((abs(math.log(photo.focal / estimated)), photo, photo.focal, estimated))
    if focals:
        _, photo, *both = max(focals, key=lambda row: row[0])
        _log.warning(
            "the focal lengths in EXIF are ignored: %s has %.0f mm (35 mm equivalent), but the photographs "
            "fit about %.0f mm; correct or remove them",
            *(photo.name, *(equivalent_focal(focal, photo.size) for focal in both)),
        )


def _facts_of_left_out(folder: Path, files: list[LeftOut], disconnected: list[str]) -> list[Fact]:
    facts = []
    if files:
        lines = left_out_lines(folder, files) or [COMPANION]
        text = f"{len(files)} left out: {'; '.join(lines)}"
        facts.append(Fact("other_files", len(files), text, affects_scores=False))
    if disconnected:
        facts.append(Fact("disconnected_photographs", ", ".join(disconnected)))
    return facts
