"""The choice itself: made once the first points are there, before the first iteration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import monotonic
from typing import TYPE_CHECKING, NamedTuple

from registry.pipeline import Pipeline

from .cost import LEAST_ITERATIONS, Cost
from .messages import Say, tell_choice, tell_cost
from .table import GROWTH, Quality, by_length, by_quality

if TYPE_CHECKING:
    from registry.runs import InitialState

    from .rehearsal import Clock, Measured

REHEARSED = 0.04
"""Of the seconds, for measuring iterations."""
GROWN = 100_000
"""Gaussians that a pipeline of unknown growth is expected to end with, if it begins with fewer."""

Load = Callable[[str], Pipeline]
"""A ready pipeline by name, for the scene at hand, with the user's changes."""


@dataclass(frozen=True)
class Budget:
    """Seconds for a run.

    Args:
        seconds: for all of it, > 0.
        begin: what `clock` showed when they began to count.
        clock: of the wall, unless a test says otherwise.
    """

    seconds: float
    begin: float
    clock: Clock = monotonic

    @property
    def spent(self) -> float:
        """Seconds until now."""
        return self.clock() - self.begin


def fit_length(initial: InitialState, budget: Budget, say: Say) -> Pipeline:
    """The pipeline at hand, as long as fits into the seconds and no longer than it says itself.

    Raises:
        RunError: there are too few seconds.
    """
    own, first = initial.pipeline, len(initial.gaussians)
    last = max(first, GROWN) if own.items["densification"] else first
    growth = _growth(own, (first + last) / 2, last)
    cost, measured = _cost(initial, budget, growth)
    cost.refuse_too_little(budget.seconds, min(LEAST_ITERATIONS, own.training.iterations))
    count = min(cost.iterations(budget.seconds), own.training.iterations)
    fitted = _within_budget(own, count, growth)
    tell_choice(fitted, "", initial, say)
    tell_cost(cost, measured, count, budget.seconds, say)
    return fitted


def choose(initial: InitialState, wanted: Quality | Budget, load: Load, say: Say) -> Pipeline:
    """The best pipeline for the scene that needs no network, at the length that is wanted.

    Args:
        initial: of the pipeline that `table.SHORT` names.
        wanted: a quality, or seconds to be kept.
        load: gives the others, which begin in the same way.

    Raises:
        RunError: there are too few seconds.
    """
    if not isinstance(wanted, Budget):
        taken = by_quality(wanted)
        chosen = _ready(taken.name, initial, load)
        tell_choice(chosen, taken.because, initial, say)
        return chosen
    growth = _known_growth(initial)
    cost, measured = _cost(initial, wanted, growth)
    affordable = cost.iterations(wanted.seconds)
    taken = by_length(affordable / initial.pipeline.training.iterations)
    if taken.name != initial.pipeline.name:
        initial = initial.of(_ready(taken.name, initial, load))
        growth = _known_growth(initial)
        cost, measured = _cost(initial, wanted, growth)
        affordable = cost.iterations(wanted.seconds)
    cost.refuse_too_little(wanted.seconds, LEAST_ITERATIONS)
    count = min(affordable, round(taken.times * initial.pipeline.training.iterations))
    chosen = _within_budget(initial.pipeline, count, growth)
    tell_choice(chosen, taken.because, initial, say)
    tell_cost(cost, measured, count, wanted.seconds, say)
    return chosen


def _ready(name: str, initial: InitialState, load: Load) -> Pipeline:
    """A pipeline of the table, for the scene's views."""
    if name == initial.pipeline.name:
        return initial.pipeline
    return load(name).for_views(len(initial.scene.train))


class _Growth(NamedTuple):
    """How many Gaussians a run has on average, and at most."""

    mean: int
    most: int


def _growth(pipeline: Pipeline, mean: float, most: float) -> _Growth:
    """Within the pipeline's own limit."""
    limit = pipeline.training.max_gaussians or int(most)
    return _Growth(max(1, min(int(mean), limit)), max(1, min(int(most), limit)))


def _known_growth(initial: InitialState) -> _Growth:
    mean, most = GROWTH[initial.pipeline.name]
    first = len(initial.gaussians)
    return _growth(initial.pipeline, mean * first, most * first)


def _cost(initial: InitialState, budget: Budget, growth: _Growth) -> tuple[Cost, Measured]:
    from .rehearsal import rehearse

    measured = rehearse(initial, growth.mean, budget.clock, REHEARSED * budget.seconds)
    return Cost(budget.spent, measured.iteration, measured.after), measured


def _within_budget(pipeline: Pipeline, count: int, growth: _Growth) -> Pipeline:
    """Scaled, with a bound on what may grow, and without scores on the way."""
    fitted = pipeline.scaled(count)
    changes = {"max_gaussians": growth.most, "evaluate_every": 0}
    return replace(fitted, training=fitted.training.model_copy(update=changes))
