"""Which views see the same part of a scene, from cameras and depth bounds alone."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from core_rasterizer import Camera

    from ...contract.scene import TrainingView

_GRID = (24, 18)
"""Columns and rows of the grid on which the overlap is counted."""
_DEPTHS = 6
"""Number of depths for that, evenly spaced in inverse depth."""


def sources_by_overlap(
    view: TrainingView,
    views: Sequence[TrainingView],
    bounds: tuple[float, float],
    min_overlap: float,
) -> tuple[list[TrainingView], list[TrainingView]]:
    """Return the other views with at least this `view_overlap`, and those with less, nearest first."""
    center = view.camera.center
    others = sorted(
        (other for other in views if other is not view),
        key=lambda other: float((other.camera.center - center).norm()),
    )
    sources = [o for o in others if view_overlap(view.camera, o.camera, bounds) >= min_overlap]
    return sources, [other for other in others if other not in sources]


def view_overlap(camera: Camera, other: Camera, bounds: tuple[float, float]) -> float:
    """Return the share of a camera's pixels in [0, 1] that another may see, over depths between the bounds.

    Occlusion is unknown, so this is an upper bound.
    """
    import torch

    from core_rasterizer.matching import seen_by_any

    columns, rows = _GRID
    small = camera.resized(columns, rows)
    near, far = bounds
    inverse_depths = torch.linspace(1 / near, 1 / far, _DEPTHS, dtype=torch.float64).tolist()
    shares = [
        float(seen_by_any(torch.full((rows, columns), 1 / inverse), small, [other]).float().mean())
        for inverse in inverse_depths
    ]
    return sum(shares) / len(shares)
