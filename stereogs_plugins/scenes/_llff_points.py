"""Structure-from-motion points that come with an LLFF scene, filtered to the training views.

The points' positions were estimated from all photographs, test views among them; keeping only points
that the training views see removes most of that knowledge but not all of it. The `sfm` initializer
with `source: triangulate` starts from the training photographs alone.
"""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from registry import PointCloud, SceneError

from ._colmap_files import read_image_names, read_points3d

MIN_TRAINING_OBSERVATIONS = 2
"""A point that two training views see could have been triangulated from them; one view cannot."""


@dataclass(frozen=True)
class _Tracks:
    positions: NDArray[np.float32]  # [P, 3]
    colors: NDArray[np.uint8]  # [P, 3]
    lengths: NDArray[np.int64]  # [P] observations of each point
    images: NDArray[np.int64]  # [sum of lengths] 0-based sorted images, track after track


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
    elif (model / "points3D.bin").is_file():
        path, tracks = model, _read_colmap(model, image_count)
    else:
        return None
    _check(tracks, image_count, path)
    owner = np.repeat(np.arange(len(tracks.lengths)), tracks.lengths)
    seen = np.bincount(owner[np.isin(tracks.images, training)], minlength=len(tracks.lengths))
    keep = seen >= min(MIN_TRAINING_OBSERVATIONS, len(training))
    if not keep.any():
        return None
    return PointCloud(
        positions=torch.from_numpy(tracks.positions[keep]),
        colors=torch.from_numpy(tracks.colors[keep].astype(np.float32) / 255),
    )


def _read_archive(path: Path) -> _Tracks:
    try:
        with np.load(path, allow_pickle=False) as data:
            return _Tracks(
                positions=np.asarray(data["xyz"], dtype=np.float32),
                colors=np.asarray(data["rgb"], dtype=np.uint8),
                lengths=np.asarray(data["track_len"], dtype=np.int64),
                images=np.asarray(data["track_image_ids"], dtype=np.int64) - 1,
            )
    except (OSError, ValueError, TypeError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise SceneError(
            f"the points file cannot be read: {error}", where=str(path), fix=_FIX
        ) from error


def _read_colmap(folder: Path, image_count: int) -> _Tracks:
    try:
        names = read_image_names(folder / "images.bin")
        points = read_points3d(folder / "points3D.bin")
    except (OSError, ValueError) as error:
        raise SceneError(
            f"the COLMAP model cannot be read: {error}", where=str(folder), fix=_FIX
        ) from error
    if len(names) != image_count:
        raise SceneError(
            f"the COLMAP model knows {len(names)} images, the scene has {image_count}",
            where=str(folder),
            fix=_FIX,
        )
    # The resized photographs may be renamed, but never reordered. An unknown id becomes -1: refused.
    index = {identity: k for k, identity in enumerate(sorted(names, key=lambda i: names[i]))}
    tracks = [index.get(identity, -1) for point in points for identity in point.image_ids]
    return _Tracks(
        positions=np.array([p.position for p in points], dtype=np.float32).reshape(-1, 3),
        colors=np.array([p.color for p in points], dtype=np.uint8).reshape(-1, 3),
        lengths=np.array([len(p.image_ids) for p in points], dtype=np.int64),
        images=np.array(tracks, dtype=np.int64),
    )


def _check(tracks: _Tracks, image_count: int, path: Path) -> None:
    count = len(tracks.lengths)
    problem = ""
    if tracks.positions.shape != (count, 3) or tracks.colors.shape != (count, 3):
        problem = (
            f"positions {tracks.positions.shape}, colours {tracks.colors.shape} and "
            f"track lengths {tracks.lengths.shape} do not belong together"
        )
    elif (tracks.lengths < 0).any() or tracks.lengths.sum() != len(tracks.images):
        problem = (
            f"the track lengths add up to {tracks.lengths.sum()}, "
            f"but the tracks have {len(tracks.images)} entries"
        )
    elif count and (tracks.images.min() < 0 or tracks.images.max() >= image_count):
        problem = f"a track names an image that is not one of the {image_count}"
    elif not np.isfinite(tracks.positions).all():
        row = int(np.flatnonzero(~np.isfinite(tracks.positions).all(axis=1))[0])
        problem = f"point {row} is not finite"
    if problem:
        raise SceneError(f"the points file is inconsistent: {problem}", where=str(path), fix=_FIX)


_FIX = "restore the file, or set `points: false` to do without it"
