"""Which other views help to find a view's depth."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from core_rasterizer import Camera
    from registry import TrainingView

_GRID = (24, 18)
"""Columns and rows on which the overlap of two views is counted."""
_DEPTHS = 6
"""Depths at which it is, evenly spaced in inverse depth."""


def sorted_by_use(
    view: TrainingView,
    views: Sequence[TrainingView],
    bounds: tuple[float, float],
    min_overlap: float,
) -> tuple[list[TrainingView], list[TrainingView]]:
    """The other views that overlap one, and those that do not; each time the nearest cameras first.

    Args:
        min_overlap: the `overlap` from which a view helps.
    """
    center = view.camera.center
    others = sorted(
        (other for other in views if other is not view),
        key=lambda other: float((other.camera.center - center).norm()),
    )
    helps = [overlap(view.camera, other.camera, bounds) >= min_overlap for other in others]
    pairs = list(zip(others, helps, strict=True))
    return [other for other, yes in pairs if yes], [other for other, yes in pairs if not yes]


def overlap(camera: Camera, other: Camera, bounds: tuple[float, float]) -> float:
    """The share of a camera's pixels, in [0, 1], that another may see too.

    Over depths between the bounds; what stands between is not known, so this is an upper bound.
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
