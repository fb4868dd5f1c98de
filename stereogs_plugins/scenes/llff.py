"""`llff`: real forward-facing captures with `poses_bounds.npy` (Mildenhall et al. 2019).

Split (RegNeRF and the sparse-view literature since): every 8th photograph of the name-sorted list is a
test view; of the rest, T, the training views are `T[round(x)]` for x in `linspace(0, len(T) - 1, n)`.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from pydantic import Field
from torch import Tensor

from registry import (
    Register,
    Scene,
    SceneError,
    SceneLoader,
    Settings,
    View,
    hookimpl,
    validate,
)

from ._llff_points import read_points
from ._llff_poses import PoseRow, read_poses

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".bmp")


class LLFFSettings(Settings):
    path: Path
    """The scene's folder; it holds poses_bounds.npy and the photographs."""
    train_views: int | None = Field(3, ge=0)
    """How many training views; null or 0 takes all that are not test views."""
    test_every: int = Field(8, ge=2)
    """Every so-many-th photograph of the sorted list is a test view, from the first on."""
    downsample: int = Field(8, ge=1)
    """Which folder of photographs: images_8 for 8, images for 1."""
    points: bool = True
    """Read structure-from-motion points, if there are any; only those that the training views see."""


class LLFFScene(SceneLoader[LLFFSettings]):
    """Reads an LLFF scene folder: `poses_bounds.npy`, `images_N/` and, if present, points."""

    Settings = LLFFSettings

    def load(self) -> Scene:
        """Return the scene.

        Raises:
            SceneError: a missing folder or file, a number of poses that is not the number of images, an
                image of another size, a pose that is not finite, more training views than there are.
        """
        settings = self.settings
        folder = settings.path.expanduser()
        if not folder.is_dir():
            raise SceneError(
                "the scene's folder does not exist",
                where=str(folder),
                fix="set `path` to the folder that holds poses_bounds.npy",
            )
        rows = read_poses(folder / "poses_bounds.npy")
        images = _list_images(folder, settings.downsample)
        if len(images) != len(rows):
            raise SceneError(
                f"there are {len(rows)} poses but {len(images)} images",
                where=f"{folder / 'poses_bounds.npy'} and {images[0].parent}",
                fix="restore the missing images, or remove the rows of images that were taken out",
            )
        train, test = split(len(images), settings.test_every, settings.train_views, str(folder))
        views = {index: _view(images[index], rows[index]) for index in sorted(train + test)}
        _check_sizes(list(views.values()), images[0].parent)
        points = read_points(folder, len(images), train) if settings.points else None
        return validate(
            Scene(
                name=folder.resolve().name,
                train=tuple(views[index] for index in train),
                test=tuple(views[index] for index in test),
                bounds=(min(rows[i].near for i in train), max(rows[i].far for i in train)),
                points=points,
                notes={
                    "source": images[0].parent.name,
                    "resolution": "{0.width}x{0.height}".format(views[train[0]].camera),
                    "train": train,
                    "test": test,
                    "points": len(points) if points else 0,
                },
            )
        )


def split(
    count: int, test_every: int, train_views: int | None, where: str
) -> tuple[list[int], list[int]]:
    """Indices of the training and the test views among `count` sorted photographs.

    Raises:
        SceneError: fewer than `train_views` photographs are left beside the test views.
    """
    test = list(range(0, count, test_every))
    pool = [index for index in range(count) if index % test_every]
    wanted = train_views or len(pool)
    if wanted > len(pool) or not pool:
        raise SceneError(
            f"{max(wanted, 1)} training views are wanted, but of {count} photographs only {len(pool)} "
            "are not test views",
            where=where,
            fix=f"set `train_views` to at most {len(pool)}, or raise `test_every`",
        )
    # numpy rounds halves to even, as the published splits do.
    chosen = np.round(np.linspace(0, len(pool) - 1, wanted)).astype(int)
    return [pool[k] for k in chosen], test


def _list_images(folder: Path, downsample: int) -> list[Path]:
    images = folder / ("images" if downsample == 1 else f"images_{downsample}")
    found = (
        sorted(path for path in images.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES)
        if images.is_dir()
        else []
    )
    if not found:
        present = ", ".join(sorted(path.name for path in folder.glob("images*"))) or "none"
        raise SceneError(
            f"there are no images for downsample {downsample}",
            where=str(images),
            fix=f"set `downsample` to a folder that is there (found: {present})",
        )
    return found


def _view(path: Path, row: PoseRow) -> View:
    image = _read_image(path)
    height, width = image.shape[:2]
    return View(name=path.stem, camera=row.camera(width, height), image=image)


def _check_sizes(views: list[View], folder: Path) -> None:
    sizes = Counter((view.camera.width, view.camera.height) for view in views)
    usual = sizes.most_common(1)[0][0]
    for view in views:
        size = (view.camera.width, view.camera.height)
        if size != usual:
            raise SceneError(
                f"the image is {size[0]}x{size[1]}, the others are {usual[0]}x{usual[1]}",
                where=str(folder / view.name),
                fix="resize all photographs of the scene in one way",
            )


def _read_image(path: Path) -> Tensor:
    try:
        with Image.open(path) as file:
            pixels = np.array(file.convert("RGB"), dtype=np.float32)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise SceneError(
            f"the image cannot be read: {error}",
            where=str(path),
            fix="restore the file, or remove it together with its row in poses_bounds.npy",
        ) from error
    return torch.from_numpy(pixels / 255)


@hookimpl
def stereogs_register_scenes(register: Register[LLFFScene]) -> None:
    register("llff", LLFFScene)
