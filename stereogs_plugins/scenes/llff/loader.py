"""`llff`: captures with `poses_bounds.npy` (Mildenhall et al. 2019), also Mip-NeRF 360 in this format.

If photographs were removed from a capture, `split.json` next to the poses lists the photograph of every row:
`{"all_names": ["first.jpg", ...]}`. The split is then that of the whole capture.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import pydantic

from registry import Register, Scene, SceneError, SceneLoader, hookimpl
from registry.photos import (
    ImageSourceSettings,
    LoadedPhotos,
    PosedPhoto,
    SplitSettings,
    estimate_bounds,
    inside,
    list_images,
    read_document,
    split,
    split_rule,
)

if TYPE_CHECKING:
    from collections.abc import Mapping


class LLFFSettings(SplitSettings, ImageSourceSettings):
    path: Path
    """Path of the scene's folder with poses_bounds.npy and the photographs."""
    bounds: Literal["file", "estimate"] = "file"
    """Source of the depth bounds: the file, or an estimate from points and cameras. Mip-NeRF 360 needs
    `estimate`, because its files have the same two numbers for every scene."""
    points: bool = True
    """Use those structure-from-motion points, if any, that the training views see."""


class LLFFScene(SceneLoader[LLFFSettings]):
    """Loader of LLFF scenes: `poses_bounds.npy`, `images_N/` and, if present, points."""

    recognized_by: ClassVar[str] = "poses_bounds.npy"

    @classmethod
    def recognizes(cls, folder: Path) -> bool:
        """Return True if the folder contains poses_bounds.npy."""
        return (folder / "poses_bounds.npy").is_file()

    @classmethod
    def demo_settings(cls, folder: Path) -> Mapping[str, Any] | None:
        """Three training views, if the folder has photographs at 1/8 size."""
        return {"train_views": 3} if (folder / "images_8").is_dir() else None

    def load(self) -> Scene:
        """Return the scene.

        Raises:
            SceneError: a missing folder or file, different numbers of poses and images, an image of another
                size, a pose that is not finite, or too few photographs for `train_views`.
        """
        from .files import read_points, read_poses

        settings = self.settings
        folder = settings.path.expanduser()
        if not folder.is_dir():
            raise SceneError(
                "the scene's folder does not exist",
                where=str(folder),
                fix="set `path` to the folder with poses_bounds.npy",
            )
        rows = read_poses(folder / "poses_bounds.npy")
        images = _image_of_each_row(folder, settings.image_folder(folder), len(rows))
        train, test = split(len(rows), settings.test_every, settings.train_views, str(folder))
        photos = [
            PosedPhoto(path.stem, path, row.world_to_camera, row.lens, row.where)
            for path, row in ((images[index], rows[index]) for index in train + test)
        ]
        loaded = LoadedPhotos.load(photos, settings.decoder(), train, test)
        loaded.require_one_size()
        points = read_points(folder, len(rows), train) if settings.points else None
        if settings.bounds == "estimate":
            bounds = estimate_bounds(loaded.training_cameras, points, str(folder))
        else:
            bounds = min(rows[k].near for k in train), max(rows[k].far for k in train)
        facts = loaded.split_facts(split_rule(settings.test_every), len(rows))
        return loaded.scene("llff", folder, bounds, points, facts)


class _Split(pydantic.BaseModel):
    all_names: tuple[str, ...]


def _image_of_each_row(folder: Path, images: Path, row_count: int) -> list[Path]:
    """Paths in the order of the rows; some of those listed in `split.json` may not exist."""
    names = folder / "split.json"
    found = list_images(images)
    if names.is_file():
        fix = 'write {"all_names": [...]} with one name for each row, or remove the file'
        listed = read_document(names, _Split, fix).all_names
        found = [inside(images, name, str(names)) for name in listed]
    if len(found) != row_count:
        raise SceneError(
            f"there are {row_count} poses but {len(found)} images",
            where=f"{folder / 'poses_bounds.npy'} and {names if names.is_file() else images}",
            fix="restore the missing images, or remove the rows of the missing images",
        )
    return found


@hookimpl
def stereogs_register_scenes(register: Register[LLFFScene]) -> None:
    register("llff", LLFFScene)
