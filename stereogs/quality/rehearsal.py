"""Measure the duration of iterations and scores on this machine, for the run that is about to start.

Iterations from all parts of the schedule train a copy of the Gaussians with a second set of components. The
priors and metrics are the run's own; their state is restored afterwards.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import fmean
from tempfile import TemporaryDirectory
from typing import NamedTuple

import torch

from core_rasterizer import Gaussians, Model
from registry import View
from registry.pipeline.parts import Part, Parts
from registry.runs.evaluation import evaluate, quick
from registry.runs.preparation import Prepared
from registry.toolkit.progress import progress
from registry.training.assembly import assemble
from registry.training.trainer import Trainer

Clock = Callable[[], float]
"""Returns seconds; only differences matter."""

MOMENTS = (1 / 8, 3 / 8, 5 / 8, 7 / 8)
"""Where in the run iterations are measured, as shares of its length: images may be small at first."""
WARM_UP, WARM = 3, 1
"""Iterations that are not counted, at the first moment (kernels are compiled, buffers allocated) and at each
later one (image sizes may change)."""
MAX_MEASURED = 10
"""Largest number of iterations per moment."""
CLOSING = 0.35
"""Duration of checkpoints, exports and reports relative to that of the quick scores of all views: both
decode, render and compress as many images."""


class Measured(NamedTuple):
    """Measured durations.

    Args:
        quarters: seconds per iteration in each quarter of the run.
        after: seconds after the last iteration.
        gaussians: number of Gaussians in them.
    """

    quarters: tuple[float, ...]
    after: float
    gaussians: int

    @property
    def iteration(self) -> float:
        """Mean seconds per iteration."""
        return fmean(self.quarters)

    def seconds(self, first: int, last: int, total: int) -> float:
        """Return the seconds of the iterations after `first` up to `last`, in a run of `total`."""
        parts = len(self.quarters)
        shares = [
            max(0.0, min(last, total * (k + 1) / parts) - max(first, total * k / parts))
            for k in range(parts)
        ]
        return sum(count * each for count, each in zip(shares, self.quarters, strict=True))


def rehearse(initial: Prepared, count: int, clock: Clock, seconds: float) -> Measured:
    """Measure a pipeline on its scene.

    Args:
        count: mean number of Gaussians of the run; the initial ones are repeated to reach it.
        seconds: approximate duration of the iterations; at least one is measured after the warm-up.
    """
    progress("timing")
    pipeline, scene = initial.pipeline, initial.framed
    points, repeated = initial.points, torch.arange(count) % len(initial.gaussians)
    gaussians = Gaussians(**{k: v[repeated] for k, v in vars(initial.gaussians).items()})
    kinds = {kind: mask[repeated] for kind, mask in points.kinds.items()}
    parts = initial.parts.for_field(0)
    shared = SharedState(parts)
    trainer = assemble(parts, scene, replace(points, kinds=kinds), gaussians)
    quarters: list[float] = []
    for moment in MOMENTS:
        skipped = WARM if quarters else WARM_UP
        trainer.iteration = max(0, int(moment * pipeline.training.iterations) - skipped)
        quarters.append(_measure(trainer, skipped, clock, seconds / len(MOMENTS)))
    measured = Measured(
        tuple(quarters), _after(initial, trainer.model, parts, clock), len(gaussians)
    )
    shared.restore()
    return measured


class SharedState:
    """Random generators and states of the components outside the training loop, to be restored."""

    def __init__(self, parts: Parts) -> None:
        components = [part.component for part in parts.shared]
        self._saved = [(c, c.generator.get_state(), {**c.state()}) for c in components]

    def restore(self) -> None:
        """Restore them as they were."""
        for component, generator, state in self._saved:
            component.generator.set_state(generator)
            component.restore(state)


def _measure(trainer: Trainer, skipped: int, clock: Clock, seconds: float) -> float:
    """Return the seconds per iteration after the first `skipped`."""
    done, begin = 0, clock()
    for count, _ in enumerate(trainer.run(), 1 - skipped):
        if count <= 0:
            begin = clock()
            continue
        done = count
        if clock() - begin >= seconds or done == MAX_MEASURED:
            break
    return (clock() - begin) / max(done, 1)


def _after(initial: Prepared, model: Model, parts: Parts, clock: Clock) -> float:
    """Return the seconds after the last iteration, extrapolated from one view of each split."""
    train, test = initial.framed.train, initial.framed.test
    every, fast = parts["metrics"], quick(parts["metrics"])

    def scored(views: Sequence[View], metrics: Sequence[Part], pictures: Path | None) -> float:
        begin = clock()
        evaluate(model, initial.framed, views[:1], metrics, pictures)
        return clock() - begin

    with TemporaryDirectory() as folder:
        scored(train, fast, Path(folder))  # not counted: it imports modules
        light = scored(train, fast, Path(folder))
        whole = scored(test, every, Path(folder)) if test else 0.0
    return len(test) * whole + len(train) * light + CLOSING * (len(test) + len(train)) * light
