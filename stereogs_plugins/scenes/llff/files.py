"""Files of an LLFF scene: cameras in `poses_bounds.npy`, points as an archive or a COLMAP model.

Each row of `poses_bounds.npy` has 17 numbers: a row-major 3x5 matrix `[R | t | (height, width, focal)]`, and
the near and far depth of the view's content. `[R | t]` is camera-to-world with camera axes (down, right,
backwards); height, width and focal length are those of the full-size photograph. Rows are in the order of the
sorted file names.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from registry import PointCloud, SceneError
from registry.photos import (
    POINTS_FIX,
    Lens,
    Tracks,
    decoding,
    has_colmap_model,
    pose_from_axes,
    read_array,
    read_arrays,
    read_colmap_model,
)

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

_FIX = "set `path` to the folder of one complete LLFF scene, for example .../llff_fern"

_ARRAYS = ("xyz", "rgb", "track_len", "track_image_ids")


@dataclass(frozen=True)
class PoseRow:
    """One row in the conventions of `Camera`.

    Args:
        world_to_camera: `[4, 4]` float64, camera axes (right, down, forward).
        lens: lens of the full-size photograph; principal point at its centre.
        near, far: z-depths, world units, 0 < near < far.
        where: file and row, for error messages.
    """

    world_to_camera: NDArray[np.float64]
    lens: Lens
    near: float
    far: float
    where: str


def read_poses(path: Path) -> list[PoseRow]:
    """Read all rows of a `poses_bounds.npy`.

    Raises:
        SceneError: the file is missing, unreadable or of another shape; or a row is not finite, has a size
            or focal length that is not positive, or depth bounds out of order.
    """
    rows = read_array(path, "the camera file poses_bounds.npy", _FIX)
    with decoding("the camera file", path, _FIX):
        rows = np.asarray(rows, dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] != 17 or not len(rows):
        raise SceneError(
            f"the camera file has shape {rows.shape}, expected (number of images, 17)",
            where=str(path),
            fix="check that this is the poses_bounds.npy of an LLFF scene",
        )
    return [_parse(row, f"{path}, row {index}") for index, row in enumerate(rows)]


def _parse(row: NDArray[np.float64], where: str) -> PoseRow:
    if not np.isfinite(row).all():
        column = int(np.flatnonzero(~np.isfinite(row))[0])
        raise SceneError(
            f"the pose contains {row[column]:g} in column {column}",
            where=where,
            fix="remove this photograph and its row, or estimate the poses again",
        )
    matrix = row[:15].reshape(3, 5)
    height, width, focal = (float(value) for value in matrix[:, 4])
    for name, value in (("height", height), ("width", width), ("focal length", focal)):
        if value <= 0:
            raise SceneError(
                f"the {name} is {value:g}; it must be positive",
                where=where,
                fix="check the file; a mirrored pose needs flipped axes, not a negative focal length",
            )
    near, far = row[15:]
    if not 0 < near < far:
        raise SceneError(
            f"the depth bounds are {near:g} .. {far:g}; they must satisfy 0 < near < far",
            where=where,
            fix="estimate the bounds again from the depths of the points in this view",
        )
    down, right, backwards, center = matrix[:, :4].T
    return PoseRow(
        world_to_camera=pose_from_axes(right, down, -backwards, center),
        lens=Lens(focal, focal, width / 2, height / 2, width, height),
        near=float(near),
        far=float(far),
        where=where,
    )


def read_points(folder: Path, image_count: int, training: list[int]) -> PointCloud | None:
    """Read the points that at least two training views see; None if the scene has no points.

    Reads `points3d.npz` if it exists, otherwise the COLMAP model in `sparse/0`.

    Args:
        folder: folder of the scene.
        image_count: number of photographs in the scene.
        training: indices of the training views in the sorted list of photographs.

    Raises:
        SceneError: a file of points exists but cannot be used.
    """
    archive, model = folder / "points3d.npz", folder / "sparse" / "0"
    if archive.is_file():
        path, tracks = archive, _read_archive(archive)
    elif has_colmap_model(model):
        path, tracks = model, _read_colmap(model, image_count)
    else:
        return None
    tracks.check(image_count, str(path))
    return tracks.seen_by(training)


def _read_archive(path: Path) -> Tracks:
    data = read_arrays(path, _ARRAYS, "the points file", POINTS_FIX)
    with decoding("the points file", path, POINTS_FIX):
        return Tracks(
            positions=np.asarray(data["xyz"], dtype=np.float32),
            colors=np.asarray(data["rgb"], dtype=np.uint8),
            lengths=np.asarray(data["track_len"], dtype=np.int64),
            images=np.asarray(data["track_image_ids"], dtype=np.int64) - 1,
        )


def _read_colmap(folder: Path, image_count: int) -> Tracks:
    model = read_colmap_model(folder, POINTS_FIX)
    if len(model.images) != image_count:
        raise SceneError(
            f"the COLMAP model has {len(model.images)} images, the scene has {image_count}",
            where=str(folder),
            fix=POINTS_FIX,
        )
    # Resized photographs may be renamed but not reordered, so the sorted lists correspond.
    return model.tracks()
