"""Triangulated features as initial points where other views confirm too little."""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import TYPE_CHECKING

import torch

from registry import SceneError
from registry.toolkit.views import triangulated_points

if TYPE_CHECKING:
    from collections.abc import Callable

    from torch import Tensor

    from registry import PointCloud, TrainingScene

FEWEST = 0.1
"""Least number of matched features relative to the confirmed points; fewer miss most of the scene."""

_log = logging.getLogger(__name__)


def matched_or_confirmed(
    scene: TrainingScene, confirmed: PointCloud, seed: int, choose: Callable[[int], Tensor]
) -> PointCloud:
    """Points triangulated as in `sfm`, or `confirmed` if there are too few.

    A feature is matched by its whole neighbourhood, a depth by a few pixels that may look alike by chance:
    views far apart can confirm a wrong one. Scales and opacities are those of `sfm` too: few large points
    would hide each other if they were as opaque as dense ones.

    Args:
        confirmed: its facts, pictures and maps are kept.
        seed: of the triangulation.
        choose: returns the indices to keep of a number of points.
    """
    try:
        found = triangulated_points(scene, seed=seed)
    except SceneError:
        return confirmed
    if len(found) < FEWEST * len(confirmed):
        return confirmed
    chosen = choose(len(found))
    _log.info("%s: training starts from %d matched features instead", scene.name, len(chosen))
    return replace(
        confirmed,
        positions=found.positions[chosen],
        colors=found.colors[chosen],
        scales=None,
        opacities=None,
        facts={**confirmed.facts, "points_by_kind": {"matched": len(chosen)}},
        kinds={"matched": torch.ones(len(chosen), dtype=torch.bool)},
    )
