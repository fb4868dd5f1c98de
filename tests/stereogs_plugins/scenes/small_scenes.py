"""Small data sets in every format that a loader reads, all of one world with known cameras.

Each photograph shows coloured squares where its camera sees the points `POINTS`; a loader that mixes
up axes, principal points, names or sizes sees another colour there.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial.transform import Rotation

from registry import Scene, View

Array = NDArray[np.float64]
POINTS = np.array(
    [[0, 0, 0], [0.9, 0.1, 0.2], [-0.8, 0.3, -0.1], [0.2, -0.6, 0.1], [0.1, 0.7, -0.3]], dtype=float
)
COLORS = np.array(
    [[255, 255, 255], [255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 0]], dtype=np.uint8
)
GREY = 60


@dataclass(frozen=True)
class World:
    """Cameras on an arc of 60 degrees, radius 4, around the points; the truth of every data set.

    Args:
        shift: of the principal point from the image's centre, pixels.
        distortion: OpenCV's k1 k2 p1 p2.
        origin, unit: of the files; a point p is written as origin + unit * p.
    """

    count: int = 9
    width: int = 64
    height: int = 48
    shift: tuple[float, float] = (0.0, 0.0)
    distortion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    unit: float = 1.0

    @property
    def focal(self) -> float:
        return 1.4 * self.width

    @property
    def principal_point(self) -> tuple[float, float]:
        return self.width / 2 + self.shift[0], self.height / 2 + self.shift[1]

    @property
    def points(self) -> Array:
        """`POINTS` as the files have them."""
        moved: Array = np.array(self.origin) + self.unit * POINTS
        return moved

    def pose(self, index: int) -> Array:
        """World-to-camera as the files have it."""
        pose = self.plain_pose(index)
        rotation, translation = pose[:3, :3], pose[:3, 3]
        pose[:3, 3] = self.unit * translation - rotation @ np.array(self.origin)
        return pose

    def plain_pose(self, index: int) -> Array:
        """World-to-camera of `POINTS`, OpenCV axes; written down here without any code under test."""
        angle = math.radians(60) * (index / (self.count - 1) - 0.5)
        center = np.array([4 * math.sin(angle), 0.3 * (-1) ** index, -4 * math.cos(angle)])
        forward = -center / np.linalg.norm(center)
        right = np.cross([0.0, 1.0, 0.0], forward)
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(forward, right), forward])
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation, -rotation @ center
        return pose

    def project(self, index: int, points: Array = POINTS) -> Array:
        """`[P, 2]` pixels of points in the photograph as taken, distortion included."""
        pose = self.plain_pose(index)
        local = points @ pose[:3, :3].T + pose[:3, 3]
        x, y = local[:, 0] / local[:, 2], local[:, 1] / local[:, 2]
        k1, k2, p1, p2 = self.distortion
        squared = x**2 + y**2
        radial = 1 + k1 * squared + k2 * squared**2
        bent_x = x * radial + 2 * p1 * x * y + p2 * (squared + 2 * x**2)
        bent_y = y * radial + p1 * (squared + 2 * y**2) + 2 * p2 * x * y
        cx, cy = self.principal_point
        return np.stack([self.focal * bent_x + cx, self.focal * bent_y + cy], axis=1)

    def photograph(self, index: int) -> NDArray[np.uint8]:
        """`[H, W, 3]`: grey, with a square of 3x3 pixels around each point, the nearest on top."""
        pixels = np.full((self.height, self.width, 3), GREY, dtype=np.uint8)
        depth = POINTS @ self.plain_pose(index)[2, :3]
        for k in np.argsort(-depth):
            column, row = np.floor(self.project(index)[k]).astype(int)
            pixels[max(0, row - 1) : row + 2, max(0, column - 1) : column + 2] = COLORS[k]
        return pixels

    def camera_to_world_opengl(self, index: int) -> Array:
        """Columns right, up, backwards."""
        turned: Any = np.linalg.inv(self.pose(index)) @ np.diag([1.0, -1.0, -1.0, 1.0])
        return np.asarray(turned, np.float64)

    def save_photographs(self, folder: Path, names: list[str]) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        for index, name in enumerate(names):
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            Image.fromarray(self.photograph(index)).save(path)


def write_llff(folder: Path, world: World) -> Path:
    """`poses_bounds.npy` of a capture stored at half size, with points of known tracks."""
    names = [f"photo_{index:02d}.png" for index in range(world.count)]
    world.save_photographs(folder / "images_2", names)
    rows = []
    for index in range(world.count):
        right, up, backwards, center = world.camera_to_world_opengl(index)[:3].T
        size = np.array([2.0 * world.height, 2.0 * world.width, 2.0 * world.focal])
        matrix = np.stack([-up, right, backwards, center, size], axis=1)
        rows.append([*matrix.ravel(), 2.0 * world.unit, 6.0 * world.unit])
    np.save(folder / "poses_bounds.npy", np.array(rows))
    np.savez(
        folder / "points3d.npz",
        xyz=world.points,
        rgb=COLORS,
        track_len=np.full(len(POINTS), world.count),
        track_image_ids=np.tile(np.arange(world.count) + 1, len(POINTS)),
    )
    return folder


def write_blender(folder: Path, world: World) -> Path:
    """Photographs 0, 1, ... of both splits; transparent where the photograph is grey."""
    for split in ("train", "test"):
        (folder / split).mkdir(parents=True)
        frames = []
        for index in range(world.count):
            pixels = world.photograph(index)
            opaque = 255 * (pixels != GREY).any(axis=2, keepdims=True).astype(np.uint8)
            image = Image.fromarray(np.concatenate([pixels, opaque], axis=2))
            image.save(folder / split / f"r_{index}.png")
            matrix = world.camera_to_world_opengl(index).tolist()
            frames.append({"file_path": f"./{split}/r_{index}", "transform_matrix": matrix})
        angle = 2 * math.atan(world.width / 2 / world.focal)
        content = {"camera_angle_x": angle, "frames": frames}
        (folder / f"transforms_{split}.json").write_text(json.dumps(content))
    return folder


def write_nerfstudio(folder: Path, world: World) -> Path:
    """`transforms.json` with the lens at the top; the last frame has its own, which is the same."""
    names = [f"images/frame_{index:05d}.png" for index in range(world.count)]
    world.save_photographs(folder, names)
    cx, cy = world.principal_point
    k1, k2, p1, p2 = world.distortion
    size = {"w": world.width, "h": world.height, "fl_x": world.focal, "fl_y": world.focal}
    lens = {**size, "cx": cx, "cy": cy, "k1": k1, "k2": k2, "p1": p1, "p2": p2}
    frames: list[dict[str, Any]] = [
        {"file_path": name, "transform_matrix": world.camera_to_world_opengl(index).tolist()}
        for index, name in enumerate(names)
    ]
    frames[-1].update(lens)
    content = {"camera_model": "OPENCV", **lens, "frames": frames[::-1]}
    (folder / "transforms.json").write_text(json.dumps(content))
    return folder


DTU_VIEWS = 49
DTU_CENTER = np.array([-20.0, 10.0, 640.0])
DTU_RADIUS = 200.0


def write_dtu(folder: Path, world: World) -> Path:
    """49 views; the world in millimetres, `scale_mat` leads to it from that of `POINTS`."""
    world.save_photographs(folder / "image", [f"{index:06d}.png" for index in range(DTU_VIEWS)])
    (folder / "mask").mkdir()
    scale = np.diag([DTU_RADIUS * world.unit] * 3 + [1.0])
    scale[:3, 3] = DTU_CENTER * world.unit + np.array(world.origin)
    zoom = 1600 / world.width
    cx, cy = world.principal_point
    intrinsics = np.eye(4)
    intrinsics[0, [0, 2]] = world.focal * zoom, cx * zoom - 0.5
    intrinsics[1, [1, 2]] = world.focal * zoom, cy * zoom - 0.5
    matrices: dict[str, Any] = {}
    for index in range(DTU_VIEWS):
        Image.fromarray(dtu_mask(world)).save(folder / "mask" / f"{index:03d}.png")
        world_mat = intrinsics @ world.plain_pose(index) @ np.linalg.inv(scale)
        matrices[f"world_mat_{index}"] = world_mat * 10.0 ** (index % 3)  # its scale says nothing
        matrices[f"scale_mat_{index}"] = scale
    np.savez(folder / "cameras_sphere.npz", **matrices)
    return folder


def dtu_mask(world: World) -> NDArray[np.uint8]:
    """White but for the leftmost quarter, with one grey column between."""
    mask = np.full((world.height, world.width), 255, dtype=np.uint8)
    mask[:, : world.width // 4] = 0
    mask[:, world.width // 4] = 128
    return mask


def write_colmap(folder: Path, world: World, *, text: bool = False, model: str = "OPENCV") -> Path:
    """A model written by COLMAP itself; image ids run against the names, every image sees each point."""
    names = [f"IMG_{index:02d}.JPG" for index in range(world.count)]
    world.save_photographs(folder / "images", [f"{Path(name).stem}.png" for name in names])
    reconstruction = pycolmap.Reconstruction()
    cx, cy = world.principal_point
    parameters = {
        "SIMPLE_PINHOLE": [world.focal, cx, cy],
        "PINHOLE": [world.focal, world.focal, cx, cy],
        "SIMPLE_RADIAL": [world.focal, cx, cy, world.distortion[0]],
        "RADIAL": [world.focal, cx, cy, *world.distortion[:2]],
        "OPENCV": [world.focal, world.focal, cx, cy, *world.distortion],
        "FULL_OPENCV": [world.focal, world.focal, cx, cy, *world.distortion, 0, 0, 0, 0],
    }[model]
    camera = pycolmap.Camera(
        model=model, width=world.width, height=world.height, params=parameters, camera_id=1
    )
    reconstruction.add_camera_with_trivial_rig(camera)
    for index, name in enumerate(names):
        pose = world.pose(index)
        image = pycolmap.Image(
            name=name,
            camera_id=1,
            image_id=world.count - index,
            keypoints=world.project(index),
        )
        rotation = pycolmap.Rotation3d(Rotation.from_matrix(pose[:3, :3]).as_quat())
        reconstruction.add_image_with_trivial_frame(image, pycolmap.Rigid3d(rotation, pose[:3, 3]))
    for number, (point, color) in enumerate(zip(world.points, COLORS, strict=True)):
        track = pycolmap.Track()
        for index in range(world.count):
            track.add_element(world.count - index, number)
        reconstruction.add_point3D(point, track, color)
    (folder / "sparse" / "0").mkdir(parents=True)
    if text:
        reconstruction.write_text(folder / "sparse" / "0")
    else:
        reconstruction.write_binary(folder / "sparse" / "0")
    return folder


def colors_at_points(view: View) -> Array:
    """`[P, 3]` 0..255: what the view shows where its own camera sees `POINTS`."""
    pose, camera = view.camera.world_to_camera.numpy(), view.camera
    local = POINTS @ pose[:3, :3].T + pose[:3, 3]
    columns = np.floor(camera.fx * local[:, 0] / local[:, 2] + camera.cx).astype(int)
    rows = np.floor(camera.fy * local[:, 1] / local[:, 2] + camera.cy).astype(int)
    return np.asarray(view.image.numpy()[rows, columns] * 255, dtype=np.float64)


def assert_sees_the_points(scene: Scene, tolerance: float = 1.0) -> None:
    """Assert that every view shows every point in its colour at its projection."""
    for view in (*scene.train, *scene.test):
        np.testing.assert_allclose(
            colors_at_points(view), COLORS, atol=tolerance, err_msg=view.name
        )
