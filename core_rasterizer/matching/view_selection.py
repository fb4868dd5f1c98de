"""Selection of source views: those that see the same part of the scene at a small angle.

The score follows MVSNet (Yao et al., ECCV 2018, section 4.1), which sums a weight of the triangulation
angle over reconstructed points. Without a reconstruction, it uses points throughout the view's frustum.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from ..camera import Camera

MIN_BASELINE = 1e-4
"""Relative to the near bound; closer cameras have no parallax."""
BEST_ANGLE = 5.0
"""Degrees between the rays of two views: less makes depth inaccurate, more changes the appearance."""
ANGLE_BELOW, ANGLE_ABOVE = 1.0, 10.0
"""Standard deviations of the weight below and above the best angle, degrees."""
GRID, DEPTHS = 8, 8
"""Points per row and column of the image, and depths per point, evenly in inverse depth."""


def source_views(
    cameras: Sequence[Camera], reference: int, count: int, bounds: tuple[float, float]
) -> list[int]:
    """Select the views to match one view with.

    Args:
        cameras: of all views.
        reference: index of the view.
        count: largest number of views.
        bounds: (near, far) z-depth of the scene's content, world units.

    Returns:
        Indices of views at other positions, nearest first: all if there are at most `count`, else those
        with the highest `matching_scores`, without scores of 0 unless all are 0. Empty if all cameras
        share one position.
    """
    here = cameras[reference].center
    distances = [float((camera.center - here).norm()) for camera in cameras]
    apart = [k for k in range(len(cameras)) if distances[k] > MIN_BASELINE * bounds[0]]
    apart.sort(key=lambda k: distances[k])
    if len(apart) <= count:
        return apart
    scores = matching_scores(cameras[reference], [cameras[k] for k in apart], bounds).tolist()
    useful = [place for place, score in enumerate(scores) if score > 0] or range(len(apart))
    best = sorted(useful, key=lambda place: -scores[place])[:count]
    return [apart[place] for place in sorted(best)]


def matching_scores(
    reference: Camera, others: Sequence[Camera], bounds: tuple[float, float]
) -> Tensor:
    """Score views by their suitability for the depths of one view.

    Args:
        reference: the view whose depths are wanted.
        others: V cameras at other positions.
        bounds: (near, far) z-depth of what the reference sees, world units.

    Returns:
        `[V]` float64 in [0, 1]: mean weight of the triangulation angle over the reference's frustum; the
        weight is 0 where the other view does not see the point, and 1 at the best angle.
    """
    points = _visible_points(reference, bounds)
    towards = torch.nn.functional.normalize(points - reference.center, dim=-1)
    scores = torch.zeros(len(others), dtype=torch.float64)
    for index, other in enumerate(others):
        seen = other.contains(*other.project(points), border=True)
        away = torch.nn.functional.normalize(points - other.center, dim=-1)
        angle = torch.rad2deg(torch.acos((towards * away).sum(dim=-1).clamp(-1, 1)))
        off = angle - BEST_ANGLE
        spread = torch.where(off < 0, ANGLE_BELOW, ANGLE_ABOVE)
        scores[index] = (seen * torch.exp(-(off**2) / (2 * spread**2))).mean()
    return scores


def _visible_points(camera: Camera, bounds: tuple[float, float]) -> Tensor:
    """World points `[P, 3]` throughout the frustum between the bounds."""
    cells = (torch.arange(GRID, dtype=torch.float64) + 0.5) / GRID
    nearness = torch.linspace(1 / bounds[1], 1 / bounds[0], DEPTHS, dtype=torch.float64)
    v, u, w = torch.meshgrid(cells * camera.height, cells * camera.width, nearness, indexing="ij")
    return camera.unproject(u.flatten(), v.flatten(), 1 / w.flatten())
