"""`llff`: real captures with `poses_bounds.npy` (Mildenhall et al. 2019), Mip-NeRF 360 in this form too.

Where photographs were taken out of a capture, `split.json` beside the poses names the photograph of
every row: `{"all_names": ["first.jpg", ...]}`. The split is then that of the whole capture.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import pydantic

from registry import Register, Scene, SceneError, SceneLoader, hookimpl
from registry.photos import (
    Bounds,
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

    from .files import PoseRow


class LLFFSettings(SplitSettings, ImageSourceSettings):
    path: Path
    """The scene's folder; it holds poses_bounds.npy and the photographs."""
    bounds: Literal["file", "estimate"] = "file"
    """Depth bounds: the file's, or estimated from points and cameras. Mip-NeRF 360 needs `estimate`,
    for its files hold the same two numbers for every scene."""
    points: bool = True
    """Read structure-from-motion points, if there are any; only those that the training views see."""


class LLFFScene(SceneLoader[LLFFSettings]):
    """Reads an LLFF scene folder: `poses_bounds.npy`, `images_N/` and, if present, points."""

    recognized_by: ClassVar[str] = "poses_bounds.npy"

    @classmethod
    def recognizes(cls, folder: Path) -> bool:
        """Whether the folder holds poses_bounds.npy."""
        return (folder / "poses_bounds.npy").is_file()

    @classmethod
    def demo_settings(cls, folder: Path) -> Mapping[str, Any] | None:
        """Three training views, where there are photographs of an eighth of their size."""
        return {"train_views": 3} if (folder / "images_8").is_dir() else None

    def load(self) -> Scene:
        """Return the scene.

        Raises:
            SceneError: a missing folder or file, a number of poses that is not the number of images, an
                image of another size, a pose that is not finite, more training views than there are.
        """
        from .files import read_points, read_poses

        settings = self.settings
        folder = settings.path.expanduser()
        if not folder.is_dir():
            raise SceneError(
                "the scene's folder does not exist",
                where=str(folder),
                fix="set `path` to the folder that holds poses_bounds.npy",
            )
        rows = read_poses(folder / "poses_bounds.npy")
        images = _image_of_each_row(folder, settings.image_folder(folder), len(rows))
        train, test = split(len(rows), settings.test_every, settings.train_views, str(folder))
        photos = [_photo(images[index], rows[index]) for index in train + test]
        loaded = LoadedPhotos.load(photos, settings.decoder(), train, test)
        loaded.require_one_size()
        points = read_points(folder, len(rows), train) if settings.points else None
        bounds = _published_bounds([rows[index] for index in train])
        if settings.bounds == "estimate":
            bounds = estimate_bounds(loaded.training_cameras, points, str(folder))
        facts = loaded.split_facts(split_rule(settings.test_every), len(rows))
        return loaded.scene("llff", folder, bounds, points, facts)


class _Split(pydantic.BaseModel):
    all_names: tuple[str, ...]


def _image_of_each_row(folder: Path, images: Path, row_count: int) -> list[Path]:
    """Paths in the order of the rows; of those that `split.json` names, some may not exist."""
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
            fix="restore the missing images, or remove the rows of images that were taken out",
        )
    return found


def _photo(path: Path, row: PoseRow) -> PosedPhoto:
    return PosedPhoto(path.stem, path, row.world_to_camera, row.lens, row.where)


def _published_bounds(rows: list[PoseRow]) -> Bounds:
    return min(row.near for row in rows), max(row.far for row in rows)


@hookimpl
def stereogs_register_scenes(register: Register[LLFFScene]) -> None:
    register("llff", LLFFScene)
