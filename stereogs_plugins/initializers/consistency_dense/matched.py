"""What the first points are where other views confirm too little: features that photographs share."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import torch

from registry import SceneError
from registry.toolkit.views.triangulation import triangulated_points

if TYPE_CHECKING:
    from collections.abc import Callable

    from torch import Tensor

    from registry import PointCloud, TrainingScene

FEWEST = 0.1
"""Of the number of confirmed points: with fewer, matched features leave most of the scene out."""


def matched_points(
    scene: TrainingScene, confirmed: PointCloud, seed: int, choose: Callable[[int], Tensor]
) -> PointCloud | None:
    """Points as `sfm` triangulates them, in place of the confirmed ones; None if they are too few.

    A feature is told apart by its whole neighbourhood, a depth by a few pixels that happen to look alike; of
    views that are far apart two may well confirm a wrong one. Sizes and opacities are those of `sfm` too: as
    opaque as dense points, few and large ones would hide each other.

    Args:
        confirmed: with the facts, pictures and maps that are kept.
        seed: of the triangulation.
        choose: the indices that are kept of so many points.
    """
    try:
        found = triangulated_points(scene, seed=seed)
    except SceneError:
        return None
    if len(found) < FEWEST * len(confirmed):
        return None
    chosen = choose(len(found))
    return replace(
        confirmed,
        positions=found.positions[chosen],
        colors=found.colors[chosen],
        scales=None,
        opacities=None,
        facts={**confirmed.facts, "points_by_kind": {"matched": len(chosen)}},
        kinds={"matched": torch.ones(len(chosen), dtype=torch.bool)},
    )
