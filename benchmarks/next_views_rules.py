"""Rules that choose the next photograph of a pool, for `benchmarks.next_views`."""

from __future__ import annotations

from collections.abc import Callable

import torch

from benchmarks.next_views_scenes import PoolScene
from registry.runs.run import Run
from stereogs.verbs.next_views import next_views

Chosen = tuple[int, ...]
"""Indices of photographs in the pool, in the order in which they were chosen."""
DRAWS = 5


def longest_gap(scene: PoolScene, chosen: Chosen) -> int:
    """Return the photograph in the middle of the longest gap in the order of the capture."""
    return max(_rest(scene, chosen), key=lambda k: (min(abs(k - one) for one in chosen), -k))


def farthest(scene: PoolScene, chosen: Chosen) -> int:
    """Return the photograph whose camera is farthest from the nearest one that was chosen."""
    centers = torch.stack([camera.center for camera in scene.cameras])
    distances = torch.cdist(centers, centers[list(chosen)]).amin(dim=1)
    return int(distances.argmax())


def drawn(draw: int) -> Callable[[PoolScene, Chosen], int]:
    """Return a rule that follows one random order of the pool."""

    def choose(scene: PoolScene, chosen: Chosen) -> int:
        generator = torch.Generator().manual_seed(draw)
        order = torch.randperm(len(scene.cameras), generator=generator).tolist()
        return next(int(k) for k in order if k not in chosen)

    return choose


RULES: dict[str, Callable[[PoolScene, Chosen], int]] = {
    "longest gap": longest_gap,
    "farthest": farthest,
    **{f"random {draw}": drawn(draw) for draw in range(DRAWS)},
}
"""Rules that need no training."""


def suggested(scene: PoolScene, chosen: Chosen, run: Run) -> int:
    """Return what `stereogs next` suggests for a run on the photographs that were chosen."""
    rest = _rest(scene, chosen)
    (best,) = next_views(run, [scene.cameras[k] for k in rest], count=1)
    return rest[best.index]


def _rest(scene: PoolScene, chosen: Chosen) -> list[int]:
    return [k for k in range(len(scene.cameras)) if k not in chosen]
