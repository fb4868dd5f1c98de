"""Published cameras of the data sets that `benchmarks.photos` compares with."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from registry.toolkit.photos import Lens, pose_from_opengl, read_colmap_model
from stereogs_plugins.scenes.dtu.cameras import calibrated
from stereogs_plugins.scenes.llff import read_poses
from stereogs_plugins.scenes.photos.unposed_photos import UnposedPhoto, read_folder

SCENES = (
    "llff_fern",
    "llff_flower",
    "llff_fortress",
    "llff_room",
    "colmap_lightfield9",
    "dtu_scan24",
    "dtu_scan65",
    "dtu_scan114",
    "mview_temple",
    "mip360_bonsai",
    "blender_lego",
)


@dataclass(frozen=True)
class Published:
    """A published camera.

    Args:
        pose: `[4, 4]`, world to camera.
        lens: Its lens.
    """

    pose: NDArray[np.float64]
    lens: Lens

    @property
    def focal(self) -> float:
        """Focal length in units of the picture's longer side."""
        return self.lens.fx / max(self.lens.width, self.lens.height)


def pictures(scene: str) -> tuple[list[UnposedPhoto], dict[str, Published]]:
    """Return the pictures of a scene in the order they were taken, and their cameras by stem."""
    folder = Path(os.environ["STEREOGS_DATA"], scene)
    published = dict(_published(folder))
    folders = [path for path in sorted(folder.glob("image*")) if path.is_dir()]
    photos = read_folder((folders or [folder / "train"])[0]).photos
    # lego's names have numbers without leading zeros.
    photos.sort(key=lambda photo: (len(photo.path.stem), photo.path.stem))
    return [photo for photo in photos if photo.path.stem in published], published


def _published(folder: Path) -> Iterator[tuple[str, Published]]:
    transforms = [*folder.glob("transforms_train.json"), *folder.glob("transforms.json")]
    if (folder / "cameras_sphere.npz").is_file():
        return _dtu(folder)
    if transforms:
        return _transforms(json.loads(transforms[0].read_text("utf-8")), folder)
    if (folder / "poses_bounds.npy").is_file():
        return _llff(folder)
    return _colmap(folder)


def _llff(folder: Path) -> Iterator[tuple[str, Published]]:
    rows = read_poses(folder / "poses_bounds.npy")
    listed = folder / "split.json"
    if listed.is_file():
        names = [Path(name).stem for name in json.loads(listed.read_text("utf-8"))["all_names"]]
    else:
        names = [path.stem for path in sorted((folder / "images_8").iterdir())]
    for name, row in zip(names, rows, strict=True):
        yield name, Published(row.world_to_camera, row.lens)


def _dtu(folder: Path) -> Iterator[tuple[str, Published]]:
    numbers = {int(path.stem): path.stem for path in (folder / "image").iterdir()}
    for number, camera in calibrated(folder / "cameras_sphere.npz", list(numbers)).cameras.items():
        yield numbers[number], Published(camera.world_to_camera, camera.lens)


def _transforms(content: dict[str, Any], folder: Path) -> Iterator[tuple[str, Published]]:
    if "fl_x" in content:
        fx, fy, cx, cy, width, height = (
            float(content[key]) for key in ("fl_x", "fl_y", "cx", "cy", "w", "h")
        )
        lens = Lens(fx, fy, cx, cy, width, height)
    else:
        focal = 0.5 / np.tan(content["camera_angle_x"] / 2)
        lens = Lens(focal, focal, 0.5, 0.5, 1, 1)  # square
    for frame in content["frames"]:
        pose = pose_from_opengl(frame["transform_matrix"], str(folder))
        yield Path(frame["file_path"]).stem, Published(pose, lens)


def _colmap(folder: Path) -> Iterator[tuple[str, Published]]:
    model = read_colmap_model(folder / "sparse" / "0", "")
    for _, image in model.images:
        yield Path(image.name).stem, Published(image.world_to_camera, model.lens(image))
