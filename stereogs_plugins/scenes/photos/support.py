"""Whether a model is borne out by the matches that it was made from.

A mapper that starts wrongly, or that is led astray by things that look alike, still answers with cameras
and points that agree among themselves: it drops the matches that disagree. They tell on it: of all
matches that fit the two-view geometry of their pair, nearly all fit a right model too.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

_Array = NDArray[np.float64]


def agreeing_share(colmap: Any, database: Path, model: Any, max_error: float) -> float:
    """The share of the verified matches between a model's photographs that its cameras agree with.

    A match agrees if its Sampson distance (Hartley and Zisserman 2004, 11.4.3) to the epipolar geometry
    of the two cameras is at most `max_error` pixels. 0 if there are no matches.
    """
    registered = set(model.reg_image_ids())
    agreeing = total = 0
    with colmap.Database.open(database) as opened:
        pairs, geometries = opened.read_two_view_geometries()
        for pair, geometry in zip(pairs, geometries, strict=True):
            first, second = colmap.pair_id_to_image_pair(pair)
            matches = geometry.inlier_matches
            if not len(matches) or not registered.issuperset((first, second)):
                continue
            points = (
                opened.read_keypoints(image)[:, :2][matches[:, side]]
                for side, image in enumerate((first, second))
            )
            errors = _sampson_distances(model, (first, second), *points)
            agreeing += int((errors <= max_error).sum())
            total += len(errors)
    return agreeing / total if total else 0.0


def _sampson_distances(
    model: Any, pair: tuple[int, int], first_points: _Array, second_points: _Array
) -> _Array:
    """Pixels of the first camera; `[M]` for points `[M, 2]` in pixels."""
    images = [model.image(identity) for identity in pair]
    cameras = [model.camera(image.camera_id) for image in images]
    rays = [
        np.column_stack([camera.cam_from_img(points), np.ones(len(points))])
        for camera, points in zip(cameras, (first_points, second_points), strict=True)
    ]
    motion = images[1].cam_from_world() * images[0].cam_from_world().inverse()
    essential = np.cross(motion.translation, motion.rotation.matrix(), axisb=0, axisc=0)
    lines = [rays[1] @ essential, rays[0] @ essential.T]
    across = (rays[1] * lines[1]).sum(axis=1)
    slope = sum((line[:, :2] ** 2).sum(axis=1) for line in lines)
    distances: _Array = cameras[0].focal_length * np.abs(across) / np.sqrt(slope)
    return distances
