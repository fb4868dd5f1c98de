"""Which other views a view is matched with: those that see the same from a little to the side.

The score follows MVSNet (Yao et al., ECCV 2018, section 4.1), which sums a weight of the triangulation
angle over reconstructed points. Here nothing is reconstructed yet, so points all over the part of the
scene that the view sees stand in for them.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from ..camera import Camera

SMALLEST_BASELINE = 1e-4
"""Relative to the near bound: a camera that stands closer to another sees no parallax."""
BEST_ANGLE = 5.0
"""Degrees between the rays of two views: less leaves the depth vague, more changes the appearance."""
ANGLE_BELOW, ANGLE_ABOVE = 1.0, 10.0
"""Standard deviations of the weight below and above the best angle, degrees."""
GRID, DEPTHS = 8, 8
"""Points a row and column of the image, and how many at each pixel, evenly in inverse depth."""


def source_views(
    cameras: Sequence[Camera], reference: int, count: int, bounds: tuple[float, float]
) -> list[int]:
    """The views to match one view with.

    Args:
        cameras: of all views.
        reference: index of the view.
        count: how many others at most.
        bounds: (near, far) z-depth of the scene's content, world units.

    Returns:
        Indices of views in other places, the nearest first: all of them if there are no more than
        `count`, else those of the highest `matching_scores`, and of these none that sees nothing of
        the same part of the scene, unless no view does. None where all cameras stand in one place.
    """
    here = cameras[reference].center
    distances = [float((camera.center - here).norm()) for camera in cameras]
    apart = [k for k in range(len(cameras)) if distances[k] > SMALLEST_BASELINE * bounds[0]]
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
    """How well other views are suited to find the depths of one.

    Args:
        reference: the camera whose depths are looked for.
        others: `[V]`, in other places.
        bounds: (near, far) z-depth of what the reference sees, world units.

    Returns:
        `[V]` float64 in [0, 1]: the mean over the visible part of space of the weight of the
        triangulation angle, which is 0 where the other view sees nothing and 1 at the best angle.
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
    """World points `[P, 3]` at which an image of the content between the bounds may show something."""
    cells = (torch.arange(GRID, dtype=torch.float64) + 0.5) / GRID
    nearness = torch.linspace(1 / bounds[1], 1 / bounds[0], DEPTHS, dtype=torch.float64)
    v, u, w = torch.meshgrid(cells * camera.height, cells * camera.width, nearness, indexing="ij")
    return camera.unproject(u.flatten(), v.flatten(), 1 / w.flatten())
