"""The cameras of a DTU scan: calibrated, or from a COLMAP model.

Calibrated cameras are in `cameras_sphere.npz`, as published with IDR and NeuS. `world_mat_i` (4x4) is
K [R | t] of the 1600x1200 photograph, the world in millimetres, pixel centres at integers. `scale_mat_i`
maps the unit sphere around the object into that world and is the same for all views of a scan. Scenes use
that sphere's radius as unit.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from registry import PointCloud, SceneError
from registry.toolkit.photos import (
    Bounds,
    Lens,
    decoding,
    pose_from_axes,
    read_arrays,
    read_colmap_model,
)

FULL_SIZE = (1600, 1200)
DEPTH_RANGE = (425.0, 935.0)
"""Depth range of MVSNet (Yao et al. 2018) and its successors for every scan, millimetres."""
_FIX = "restore cameras_sphere.npz of this scan"
_MAX_SKEW = 1e-3
_Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class DtuCamera:
    """Camera of one view: pose `[4, 4]`, and the lens of the full-size photograph."""

    world_to_camera: _Array
    lens: Lens


@dataclass(frozen=True, eq=False)
class DtuCameras:
    """Cameras by view number, with bounds and points if their file has any.

    Args:
        bounds: depth bounds in the cameras' units.
        points: points that the training views see.
    """

    cameras: dict[int, DtuCamera]
    bounds: Bounds | None = None
    points: PointCloud | None = None


def view_number(stem: str, where: str) -> int:
    """0-based number of a view: 25 for `000025` and for `rect_026_3_r5000`.

    Raises:
        SceneError: the file name has neither form.
    """
    match = re.fullmatch(r"rect_(\d{3})_.*|(\d{1,6})", stem, re.ASCII)
    if match is None:
        raise SceneError(
            f"the file name {stem[:100]!r} does not contain a view number",
            where=where,
            fix="name photographs 000000.png ... 000048.png, or as DTU does: rect_001_3_r5000.png",
        )
    return int(match[1]) - 1 if match[1] else int(match[2])


def from_colmap(folder: Path, training: list[int], view_ids: list[int]) -> DtuCameras:
    """Read cameras and points of a COLMAP model.

    Raises:
        SceneError: the model is damaged or lacks a view.
    """
    model = read_colmap_model(folder, "restore the COLMAP model, or use `cameras: calibrated`")
    numbers = [
        view_number(Path(image.name).stem, f"{folder}, image {image.name!r}")
        for _, image in model.images
    ]
    missing = sorted(set(view_ids) - set(numbers))
    if missing:
        raise SceneError(
            f"the COLMAP model has no camera for the views {missing}",
            where=str(folder),
            fix="run COLMAP on all 49 photographs, or use `cameras: calibrated`",
        )
    if len({*numbers}) < len(numbers):
        raise SceneError(
            "two images of the COLMAP model are of the same view",
            where=str(folder),
            fix="run COLMAP on one photograph of each view, or use `cameras: calibrated`",
        )
    tracks = model.tracks()
    tracks.check(len(numbers), str(folder))
    return DtuCameras(
        cameras={
            number: DtuCamera(image.world_to_camera, model.lens(image))
            for number, (_, image) in zip(numbers, model.images, strict=True)
        },
        points=tracks.seen_by([numbers.index(number) for number in training]),
    )


def calibrated(path: Path, view_ids: list[int]) -> DtuCameras:
    """Read `cameras_sphere.npz`, in units of the object's sphere.

    Raises:
        SceneError: the file is missing or damaged, lacks a view, or has a matrix that is not finite or not a
            camera.
    """
    names = [f"{kind}_mat_{k}" for kind in ("world", "scale") for k in view_ids]
    data = read_arrays(path, names, "the camera file", _FIX)
    with decoding("the camera file", path, _FIX):
        worlds = {k: np.asarray(data[f"world_mat_{k}"], dtype=np.float64) for k in view_ids}
        scales = {k: np.asarray(data[f"scale_mat_{k}"], dtype=np.float64) for k in view_ids}
    for index in view_ids:
        where = f"{path}, view {index}"
        for matrix in (worlds[index], scales[index]):
            if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
                raise SceneError("a matrix is not 4x4 or not finite", where=where, fix=_FIX)
        if not np.array_equal(scales[index], scales[view_ids[0]]):
            raise SceneError(
                "scale_mat differs from that of the other views", where=where, fix=_FIX
            )
    center, radius = _sphere(scales[view_ids[0]], str(path))
    cameras = {
        index: _decompose(worlds[index], center, radius, f"{path}, view {index}")
        for index in view_ids
    }
    depths = [float(camera.world_to_camera[2, 3]) for camera in cameras.values()]
    return DtuCameras(cameras=cameras, bounds=_bounds(depths, radius))


def _bounds(depths: list[float], radius: float) -> tuple[float, float]:
    """Return the scans' depth range; for a file in another unit than millimetres, that of the unit sphere.

    Args:
        depths: of the sphere's centre in each camera, in units of the sphere.
        radius: of the sphere in the file.
    """
    near, far = DEPTH_RANGE[0] / radius, DEPTH_RANGE[1] / radius
    nearest, farthest = min(depths), max(depths)
    if near < nearest and farthest < far:
        return near, far
    return max(nearest - 1, nearest / 4), farthest + 1


def _sphere(scale: _Array, where: str) -> tuple[_Array, float]:
    radius = float(scale[0, 0])
    expected = np.diag([radius, radius, radius, 1.0])
    expected[:3, 3] = scale[:3, 3]
    if radius <= 0 or not np.allclose(scale, expected, rtol=0, atol=1e-6 * radius):
        raise SceneError("scale_mat is not a scale and a shift", where=where, fix=_FIX)
    return scale[:3, 3], radius


def _decompose(world: _Array, center: _Array, radius: float, where: str) -> DtuCamera:
    """K, R and t of P = K [R | t] by RQ decomposition (Hartley and Zisserman 2004, 6.2.4).

    By OpenCV, because the last digits of LAPACK's depend on the processor, and training amplifies them.
    """
    import cv2

    first, second, third = world[:3, :3]
    with np.errstate(all="ignore"):  # overflow compares as False and raises below
        adjugate = np.stack(
            [np.cross(second, third), np.cross(third, first), np.cross(first, second)], axis=1
        )
        volume, length = (first * adjugate[:, 0]).sum(), np.linalg.norm(world[:3, :3])
    if not abs(volume) > 1e-9 * length**3:
        raise SceneError("world_mat is not the matrix of a camera", where=where, fix=_FIX)
    intrinsics, rotation = cv2.RQDecomp3x3(world[:3, :3])[1:3]
    signs = np.sign(np.diag(intrinsics))  # not determined by the decomposition; positive in K
    intrinsics, rotation = intrinsics * signs, signs[:, None] * rotation
    position = -(adjugate * world[:3, 3]).sum(axis=1) / volume
    intrinsics = intrinsics / intrinsics[2, 2]
    if np.linalg.det(rotation) < 0 or abs(intrinsics[0, 1]) > _MAX_SKEW * intrinsics[0, 0]:
        raise SceneError("world_mat is mirrored or has skewed pixels", where=where, fix=_FIX)
    lens = Lens(
        fx=float(intrinsics[0, 0]),
        fy=float(intrinsics[1, 1]),
        cx=float(intrinsics[0, 2]) + 0.5,
        cy=float(intrinsics[1, 2]) + 0.5,
        width=FULL_SIZE[0],
        height=FULL_SIZE[1],
    )
    right, down, forward = rotation
    pose_in_sphere = pose_from_axes(right, down, forward, (position - center) / radius)
    return DtuCamera(pose_in_sphere, lens)
