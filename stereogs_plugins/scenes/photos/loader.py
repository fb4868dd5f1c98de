"""`photos`: a folder of photographs without cameras, which COLMAP estimates."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from pydantic import Field

from registry import Fact, Register, Scene, SceneLoader, hookimpl
from registry.toolkit.photos import (
    ColmapModel,
    Decoder,
    LoadedPhotos,
    PosedPhoto,
    ResizeFilter,
    SplitSettings,
    estimate_bounds,
    longest_side,
    split,
    split_rule,
)

from .picture_files import is_pictures_alone, list_content

if TYPE_CHECKING:
    from .unposed_photos import UnposedPhoto


_log = logging.getLogger("stereogs.photos")


class PhotosSettings(SplitSettings):
    path: Path
    """Path of the folder of photographs."""
    train_views: int | None = Field(None, ge=0)
    """Number of training views; null or 0 takes all photographs that are not test views."""
    test_every: int = Field(8, ge=0)
    """Every N-th photograph of the sorted list is a test view, starting with the first; 0 gives no test
    views."""
    max_size: int = Field(800, ge=16)
    """Longer side of the training photographs after resizing, in pixels."""
    resize_filter: ResizeFilter = "bicubic"
    """Pillow filter for resizing."""
    share_lens: bool = True
    """Photographs of one size, camera and focal length (by EXIF) share one lens; false estimates one for
    each, which needs many more photographs."""
    matching_size: int = Field(1200, ge=64)
    """Longer side of the photographs for camera estimation, in pixels."""


class PhotosScene(SceneLoader[PhotosSettings]):
    """Estimates the cameras of all photographs, including test views, and undistorts them.

    Cameras are kept in the user's cache folder. Scale and horizon of the world are arbitrary.
    """

    recognized_by: ClassVar[str] = "pictures and nothing else"

    @classmethod
    def recognizes(cls, folder: Path) -> bool:
        """Return True if the folder and its subfolders contain only pictures and their companion files."""
        return is_pictures_alone(folder)

    def load(self) -> Scene:
        """Return the scene.

        Raises:
            SceneError: fewer than three photographs, an unreadable one, duplicates, or photographs that do
                not connect; the message lists those that do and suggests what to photograph next.
        """
        from .unposed_photos import read_folder

        settings = self.settings
        folder = settings.path.expanduser()
        found = read_folder(folder)
        train, test = split(len(found), settings.test_every, settings.train_views, str(folder))
        model = self._find_cameras(found, folder)
        all_photos = _posed(model, found)
        photos = [all_photos[index] for index in train + test]
        decoder = Decoder(longest_side(settings.max_size), settings.resize_filter, upright=True)
        _warn_of_transparency(found, decoder)
        loaded = LoadedPhotos.load(photos, decoder, train, test)
        tracks = model.tracks()
        tracks.check(len(found), str(folder))
        points = tracks.seen_by(train)
        bounds = estimate_bounds(loaded.training_cameras, points, str(folder))
        facts = (
            Fact("cameras", "found in all photographs by COLMAP"),
            Fact("lenses", len(model.cameras)),
            Fact("turned_upright", sum(photo.turned for photo in found)),
            Fact("focal_lengths_by_exif", sum(photo.focal is not None for photo in found)),
            *_left_out_facts(folder),
            *loaded.split_facts(split_rule(settings.test_every), len(found)),
        )
        return loaded.scene("photos", folder, bounds, points, facts)

    def _find_cameras(self, found: list[UnposedPhoto], folder: Path) -> ColmapModel:
        from .disconnected import require_one_piece
        from .found_cameras import remembered_cameras
        from .learned_matches import known_files
        from .structure_from_motion import reconstruct

        settings = self.settings
        decoder = Decoder(longest_side(settings.matching_size), "box", upright=True)
        cameras = remembered_cameras(
            found,
            f"{settings.matching_size} {settings.share_lens} {known_files() is not None}",
            lambda empty: reconstruct(found, decoder, settings.share_lens, empty),
        )
        names = [photo.name for photo in found]
        return require_one_piece(cameras, names, str(folder))


def _posed(model: ColmapModel, found: list[UnposedPhoto]) -> list[PosedPhoto]:
    from .unposed_photos import image_index

    names = _names(found)
    return [
        PosedPhoto(
            name=names[k],
            path=found[k].path,
            world_to_camera=image.world_to_camera,
            lens=model.lens(image),
            where=str(found[k].path),
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


def _warn_of_transparency(found: list[UnposedPhoto], decoder: Decoder) -> None:
    transparent = [photo.name for photo in found if photo.transparent]
    if transparent:
        color = " ".join(f"{channel:g}" for channel in decoder.background)
        _log.warning(
            "transparent pixels in %d of %d pictures, %s first, are laid on the background (%s)",
            *(len(transparent), len(found), transparent[0], color),
        )


def _left_out_facts(folder: Path) -> list[Fact]:
    """Number and names of the files that are not photographs."""
    names = [path.name for path in list_content(folder).left_out]
    few = ", ".join(names[:3]) + (", ..." if len(names) > 3 else "")
    text = f"{len(names)} left out: {few}"
    return [Fact("other_files", len(names), text, affects_scores=False)] if names else []


@hookimpl
def stereogs_register_scenes(register: Register[PhotosScene]) -> None:
    register("photos", PhotosScene)
