"""What iterations and scores cost on this machine, measured on what is about to be trained.

Iterations from all parts of the schedule train a copy of the Gaussians with a second set of components. The
run's priors and metrics are used too; their state is restored afterwards.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
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
from registry.runs import InitialState, evaluate, quick
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


def rehearse(initial: InitialState, count: int, clock: Clock, seconds: float) -> Measured:
    """Measure a pipeline on its scene.

    Args:
        count: Gaussians that a run has on average; the first ones are repeated until there are so many.
        seconds: about how long iterations are done; at least one beyond the warm-up is.
    """
    pipeline, scene = initial.pipeline, initial.scene
    points, repeated = initial.points, torch.arange(count) % len(initial.gaussians)
    gaussians = _grown(initial.gaussians, repeated)
    model = new_model(gaussians, pipeline.training, initial.device)
    parts = initial.parts.for_field(0)
    kinds = {kind: mask[repeated] for kind, mask in points.kinds.items()}
    with _unchanged(parts):
        trainer = Trainer(pipeline.training, parts, scene, model, points.maps, kinds)
        spans: list[tuple[float, int]] = []
        for moment in MOMENTS:
            skipped = WARM if spans else WARM_UP
            trainer.iteration = max(0, int(moment * pipeline.training.iterations) - skipped)
            spans.append(_measured(trainer, skipped, clock, seconds / len(MOMENTS)))
        iteration = fmean(took / done for took, done in spans)
        done = sum(done for _, done in spans)
        return Measured(iteration, _after(initial, model, parts, clock), done, len(gaussians))


@contextmanager
def _unchanged(parts: Parts) -> Iterator[None]:
    """Restore the random generators and the state of the components that the run uses too."""
    shared = [part.component for part in parts.shared]
    saved = [(one.generator.get_state(), {**one.state()}) for one in shared]
    yield
    for one, (generator, state) in zip(shared, saved, strict=True):
        one.generator.set_state(generator)
        one.restore(state)


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


def _after(initial: InitialState, model: GaussianModel, parts: Parts, clock: Clock) -> float:
    """Seconds from the last iteration on: one view of each split stands for all."""
    train, test = initial.scene.train, initial.scene.test
    every, fast = parts["metrics"], quick(parts["metrics"])

    def scored(views: Sequence[View], metrics: Sequence[Part], pictures: Path | None) -> float:
        begin = clock()
        evaluate(model, initial.scene, views[:1], metrics, pictures)
        return clock() - begin

    with TemporaryDirectory() as folder:
        scored(train, fast, Path(folder))  # what is imported at first use is imported now
        light = scored(train, fast, Path(folder))
        whole = scored(test, every, Path(folder)) if test else 0.0
    return len(test) * whole + len(train) * light + CLOSING * (len(test) + len(train)) * light


def _grown(gaussians: Gaussians, which: Tensor) -> Gaussians:
    return Gaussians(**{f.name: getattr(gaussians, f.name)[which] for f in fields(gaussians)})
