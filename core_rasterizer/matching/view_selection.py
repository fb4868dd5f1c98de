"""Selection of source views: those that see the same part of the scene at a small angle.

The score follows MVSNet (Yao et al., ECCV 2018, section 4.1), which sums a weight of the triangulation
angle over reconstructed points. Without a reconstruction, it uses points throughout the view's frustum.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

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
CANDIDATES, COARSE = 32, 2
"""Of more views, only the best by a coarse score are scored finely; points of that score per direction."""


def source_views(
    cameras: Sequence[Camera], count: int, bounds: tuple[float, float]
) -> list[list[int]]:
    """Select for each view the views to match it with.

    Args:
        cameras: of all views.
        count: largest number of views for each.
        bounds: (near, far) z-depth of the scene's content, world units.

    Returns:
        For each view the indices of views at other positions, nearest first: all if there are at most
        `count`, else those with the highest `matching_scores`, without scores of 0 unless all are 0. Empty
        if all cameras share one position.
    """
    all_lenses = _Lenses.of(cameras)
    lists = []
    for index, camera in enumerate(cameras):
        distances = (all_lenses.centers - all_lenses.centers[index]).norm(dim=-1)
        apart = torch.nonzero(distances > MIN_BASELINE * bounds[0])[:, 0]
        apart = apart[distances[apart].sort(stable=True).indices]
        if len(apart) > max(count, CANDIDATES):
            coarse = _scores(camera, all_lenses.of_views(apart), bounds, COARSE, COARSE)
            apart = apart[_best(coarse, max(count, CANDIDATES))]
        if len(apart) > count:
            apart = apart[_best(_scores(camera, all_lenses.of_views(apart), bounds), count)]
        lists.append(apart.tolist())
    return lists


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
    return _scores(reference, _Lenses.of(others), bounds)


@dataclass(frozen=True, eq=False)
class _Lenses:
    """V cameras: centers `[V, 3]`, poses `[V, 4, 4]`, and `[V, 2]` focal lengths, principal points, sizes."""

    centers: Tensor
    poses: Tensor
    focal: Tensor
    principal: Tensor
    size: Tensor

    @classmethod
    def of(cls, cameras: Sequence[Camera]) -> _Lenses:
        numbers = [[c.fx, c.fy, c.cx, c.cy, float(c.width), float(c.height)] for c in cameras]
        pairs = torch.tensor(numbers, dtype=torch.float64).reshape(-1, 3, 2).unbind(1)
        return cls(
            torch.stack([camera.center for camera in cameras]),
            torch.stack([camera.world_to_camera for camera in cameras]),
            *pairs,
        )

    def of_views(self, indices: Tensor) -> _Lenses:
        return _Lenses(*(getattr(self, field.name)[indices] for field in fields(self)))

    def sees(self, points: Tensor) -> Tensor:
        """Which world points `[P, 3]` lie in each image, borders included, `[V, P]`."""
        x, y, z = (points @ self.poses[:, :3, :3].mT + self.poses[:, None, :3, 3]).unbind(-1)
        u = self.focal[:, :1] * x / z + self.principal[:, :1]
        v = self.focal[:, 1:] * y / z + self.principal[:, 1:]
        within = (u >= 0) & (u <= self.size[:, :1]) & (v >= 0) & (v <= self.size[:, 1:])
        return within & (z > 0)


def _scores(
    reference: Camera,
    others: _Lenses,
    bounds: tuple[float, float],
    grid: int = GRID,
    depths: int = DEPTHS,
) -> Tensor:
    points = _visible_points(reference, bounds, grid, depths)
    towards = torch.nn.functional.normalize(points - reference.center, dim=-1)
    away = torch.nn.functional.normalize(points - others.centers[:, None], dim=-1)
    angle = torch.rad2deg(torch.acos((towards * away).sum(dim=-1).clamp(-1, 1)))
    off = angle - BEST_ANGLE
    spread = torch.where(off < 0, ANGLE_BELOW, ANGLE_ABOVE)
    weights: Tensor = others.sees(points) * torch.exp(-(off**2) / (2 * spread**2))
    return weights.mean(dim=-1)


def _best(scores: Tensor, count: int) -> Tensor:
    """Sorted places of the highest scores, without those of 0 unless all are 0; ties: the first."""
    useful = int((scores > 0).sum()) or len(scores)
    order = scores.sort(descending=True, stable=True).indices
    return order[: min(count, useful)].sort().values


def _visible_points(camera: Camera, bounds: tuple[float, float], grid: int, depths: int) -> Tensor:
    """World points `[P, 3]` throughout the frustum between the bounds."""
    cells = (torch.arange(grid, dtype=torch.float64) + 0.5) / grid
    nearness = torch.linspace(1 / bounds[1], 1 / bounds[0], depths, dtype=torch.float64)
    v, u, w = torch.meshgrid(cells * camera.height, cells * camera.width, nearness, indexing="ij")
    return camera.unproject(u.flatten(), v.flatten(), 1 / w.flatten())
