"""Structure-from-motion points that come with an LLFF scene, as an archive or a COLMAP model."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from registry import PointCloud, SceneError
from registry.toolkit.photos import (
    POINTS_FIX,
    Tracks,
    decoding,
    has_colmap_model,
    read_arrays,
    read_colmap_model,
)

if TYPE_CHECKING:
    from pathlib import Path

_ARRAYS = ("xyz", "rgb", "track_len", "track_image_ids")


def read_points(folder: Path, image_count: int, training: list[int]) -> PointCloud | None:
    """The points seen by at least two of the training views; None if there are none.

    Reads `points3d.npz` or, failing that, the COLMAP model in `sparse/0`.

    Args:
        folder: of the scene.
        image_count: how many photographs the scene has.
        training: indices of the training views in the sorted list of photographs.

    Raises:
        SceneError: a file of points that is there but cannot be used.
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
            f"the COLMAP model knows {len(model.images)} images, the scene has {image_count}",
            where=str(folder),
            fix=POINTS_FIX,
        )
    # The resized photographs may be renamed, but never reordered: the sorted lists correspond.
    return model.tracks()
