"""What iterations and scores cost on this machine, measured on what is about to be trained.

Iterations from all parts of the pipeline are done on copies and forgotten. Nothing of the run changes:
its components are built anew afterwards, as they are when a run is resumed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields
from pathlib import Path
from statistics import fmean
from tempfile import TemporaryDirectory
from typing import NamedTuple

import torch
from torch import Tensor

from core_rasterizer import GaussianModel, Gaussians
from registry import View
from registry.pipeline import Part, Parts
from registry.runs import Beginning, evaluate, quick
from registry.training import Trainer, new_model

from .cost import CLOSING

Clock = Callable[[], float]
"""Gives seconds; only differences count."""

MOMENTS = (1 / 8, 3 / 8, 5 / 8, 7 / 8)
"""Parts of the run in whose middle iterations are measured: photographs may be small at first."""
WARM_UP, WARM = 3, 1
"""Iterations that are not counted: before all others kernels are loaded and buffers find their sizes, at
later moments of the run photographs may change theirs."""
MOST_MEASURED = 10
"""Iterations at each moment."""


class Measured(NamedTuple):
    """What was measured.

    Args:
        iteration: seconds of one.
        after: seconds of what comes after the last one.
        iterations: how many were measured.
        gaussians: with how many.
    """

    iteration: float
    after: float
    iterations: int
    gaussians: int


def rehearse(beginning: Beginning, count: int, clock: Clock, seconds: float) -> Measured:
    """Measure a pipeline on its scene.

    Args:
        count: Gaussians that a run has on average; the first ones are repeated until there are so many.
        seconds: about how long iterations are done; at least one beyond the warm-up is.
    """
    pipeline, scene = beginning.pipeline, beginning.scene
    points, repeated = beginning.points, torch.arange(count) % len(beginning.gaussians)
    gaussians = _grown(beginning.gaussians, repeated)
    model = new_model(gaussians, pipeline.training, beginning.device)
    parts = Parts(pipeline, beginning.device)
    kinds = {kind: mask[repeated] for kind, mask in points.kinds.items()}
    trainer = Trainer(pipeline.training, parts, scene, model, points.maps, kinds)
    spans: list[tuple[float, int]] = []
    for moment in MOMENTS:
        skipped = WARM if spans else WARM_UP
        trainer.iteration = max(0, int(moment * pipeline.training.iterations) - skipped)
        spans.append(_measured(trainer, skipped, clock, seconds / len(MOMENTS)))
    iteration = fmean(took / done for took, done in spans)
    done = sum(done for _, done in spans)
    return Measured(iteration, _after(beginning, model, parts, clock), done, len(gaussians))


def _measured(trainer: Trainer, skipped: int, clock: Clock, seconds: float) -> tuple[float, int]:
    """Seconds of some iterations from where the trainer is, and how many they were.

    Args:
        skipped: not counted, the first so many.
    """
    done, begin = 0, clock()
    for count, _ in enumerate(trainer.run(), 1 - skipped):
        if count <= 0:
            begin = clock()
            continue
        done = count
        if clock() - begin >= seconds or done == MOST_MEASURED:
            break
    return clock() - begin, max(done, 1)


def _after(beginning: Beginning, model: GaussianModel, parts: Parts, clock: Clock) -> float:
    """Seconds from the last iteration on: one view of each split stands for all."""
    train, test = beginning.scene.train, beginning.scene.test
    every, fast = parts["metrics"], quick(parts["metrics"])

    def scored(views: Sequence[View], metrics: Sequence[Part], pictures: Path | None) -> float:
        begin = clock()
        evaluate(model, beginning.scene, views[:1], metrics, pictures)
        return clock() - begin

    with TemporaryDirectory() as folder:
        scored(train, fast, Path(folder))  # what is imported at first use is imported now
        light = scored(train, fast, Path(folder))
        whole = scored(test, every, Path(folder)) if test else 0.0
    return len(test) * whole + len(train) * light + CLOSING * (len(test) + len(train)) * light


def _grown(gaussians: Gaussians, which: Tensor) -> Gaussians:
    return Gaussians(**{f.name: getattr(gaussians, f.name)[which] for f in fields(gaussians)})
