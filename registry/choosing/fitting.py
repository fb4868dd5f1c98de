"""The choice itself: made once the first points are there, before the first iteration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import monotonic
from typing import TYPE_CHECKING

from ..pipeline.pipeline import Pipeline
from .cost import LEAST_ITERATIONS, Cost
from .scaling import scaled
from .table import Quality, Taken, by_length, by_quality
from .telling import Say, tell_choice, tell_cost

if TYPE_CHECKING:
    from ..runs.training_run import Beginning
    from .rehearsal import Clock, Measured

REHEARSED = 0.04
"""Of the seconds, for measuring iterations."""
MOST_GROWTH = 1.4
"""Gaussians at most in a run with a budget, over those that it begins with: what it takes stays known."""

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


def fit_length(beginning: Beginning, budget: Budget, say: Say) -> Pipeline:
    """The pipeline at hand, as long as fits into the seconds and no longer than it says itself.

    Raises:
        RunError: there are too few seconds.
    """
    own = beginning.pipeline
    cost, measured = _cost(beginning, budget)
    cost.refuse_too_little(budget.seconds, min(LEAST_ITERATIONS, own.training.iterations))
    count = min(cost.iterations(budget.seconds), own.training.iterations)
    fitted = _within_budget(own, count, beginning)
    tell_choice(fitted, "", beginning, say)
    tell_cost(cost, measured, count, budget.seconds, say)
    return fitted


def choose(beginning: Beginning, wanted: Quality | Budget, load: Load, say: Say) -> Pipeline:
    """The best pipeline for the scene that needs no network, at the length that is wanted.

    Args:
        beginning: of the pipeline that `table.SHORT` names.
        wanted: a quality, or seconds to be kept.
        load: gives the others, which begin in the same way.

    Raises:
        RunError: there are too few seconds.
    """
    views = len(beginning.scene.train)
    if not isinstance(wanted, Budget):
        taken = by_quality(wanted, views)
        pipeline = _loaded(taken, beginning, load)
        chosen = scaled(pipeline, round(taken.times * pipeline.training.iterations))
        tell_choice(chosen, taken.because, beginning, say)
        return chosen
    cost, measured = _cost(beginning, wanted)
    cost.refuse_too_little(wanted.seconds, LEAST_ITERATIONS)
    affordable = cost.iterations(wanted.seconds)
    taken = by_length(affordable / beginning.pipeline.training.iterations, views)
    pipeline = _loaded(taken, beginning, load)
    count = min(affordable, round(taken.times * pipeline.training.iterations))
    chosen = _within_budget(pipeline, count, beginning)
    tell_choice(chosen, taken.because, beginning, say)
    tell_cost(cost, measured, count, wanted.seconds, say)
    return chosen


def _loaded(taken: Taken, beginning: Beginning, load: Load) -> Pipeline:
    return beginning.pipeline if taken.name == beginning.pipeline.name else load(taken.name)


def _cost(beginning: Beginning, budget: Budget) -> tuple[Cost, Measured]:
    from .rehearsal import rehearse

    measured = rehearse(beginning, budget.clock, REHEARSED * budget.seconds)
    return Cost(budget.spent, measured.iteration, measured.after), measured


def _within_budget(pipeline: Pipeline, count: int, beginning: Beginning) -> Pipeline:
    """Scaled, with a bound on what may grow, and without scores on the way."""
    fitted = scaled(pipeline, count)
    training = fitted.training
    limit = max(int(MOST_GROWTH * len(beginning.gaussians)), 1)
    return replace(
        fitted,
        training=training.model_copy(
            update={
                "max_gaussians": min(limit, training.max_gaussians or limit),
                "evaluate_every": 0,
            }
        ),
    )
