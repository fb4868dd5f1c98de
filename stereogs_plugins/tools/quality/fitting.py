"""Choose the pipeline and its length after initialization, before the first iteration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import monotonic
from typing import TYPE_CHECKING, NamedTuple

from registry import RunError
from registry.messages import counted
from registry.pipeline import Pipeline

from .table import GROWTH, Quality, by_length, by_quality

if TYPE_CHECKING:
    from registry.runs import InitialState

    from .rehearsal import Clock, Measured

LEAST_ITERATIONS = 50
"""Shorter trainings are not worth the time that loading and saving take."""
REHEARSED = 0.04
"""Share of the budget for timing iterations."""
GROWN = 100_000
"""Assumed final number of Gaussians for a pipeline of unknown growth, if it starts with fewer."""

Load = Callable[[str], Pipeline]
"""Returns a ready pipeline by name, with the scene and changes of the command line."""
Log = Callable[[str], None]


@dataclass(frozen=True)
class Budget:
    """Seconds for a run.

    Args:
        seconds: for the whole run, > 0.
        begin: value of `clock` at the start of the run.
        clock: returns seconds; replaced by tests.
    """

    seconds: float
    begin: float
    clock: Clock = monotonic

    @property
    def spent(self) -> float:
        """Seconds since the start of the run."""
        return self.clock() - self.begin


@dataclass(frozen=True)
class Cost:
    """Duration of a run in seconds.

    Args:
        spent: before the first iteration.
        iteration: per iteration.
        after: after the last iteration: scores, images, exports, reports.
    """

    spent: float
    iteration: float
    after: float

    def seconds(self, iterations: int) -> float:
        """Return the duration of a run with so many iterations."""
        return self.spent + iterations * self.iteration + self.after

    def iterations(self, seconds: float) -> int:
        """Return how many iterations fit into `seconds`; less than 1 if none fits."""
        return int((seconds - self.spent - self.after) / self.iteration)

    def require(self, least: int, seconds: float) -> None:
        """Check that `least` iterations fit into `seconds`.

        Raises:
            RunError: they do not; the error lists the costs and the seconds needed.
        """
        if self.iterations(seconds) >= least:
            return
        raise RunError(
            f"{seconds:g} s are too few: loading and initialization took {self.spent:.1f} s, scores and "
            f"files will take {self.after:.1f} s, and each iteration {self.iteration:.3f} s",
            where="--seconds",
            fix=f"allow at least {self.seconds(least):.0f} s, for {least} iterations; fewer or smaller "
            "photographs take less time",
        )


def fit_length(initial: InitialState, budget: Budget, log: Log) -> Pipeline:
    """Return the pipeline with as many iterations as fit into the budget, at most its own number.

    Raises:
        RunError: the budget is too small.
    """
    own, first = initial.pipeline, len(initial.gaussians)
    last = max(first, GROWN) if own.items["densification"] else first
    growth = _growth(own, (first + last) / 2, last)
    cost, measured = _cost(initial, budget, growth)
    cost.require(min(LEAST_ITERATIONS, own.training.iterations), budget.seconds)
    count = min(cost.iterations(budget.seconds), own.training.iterations)
    fitted = _within_budget(own, count, growth)
    _log_choice(fitted, "", initial, log)
    _log_cost(cost, measured, count, budget.seconds, log)
    return fitted


def choose(initial: InitialState, wanted: Quality | Budget, load: Load, log: Log) -> Pipeline:
    """Return the best pipeline without a network for the scene and the quality or budget.

    Args:
        initial: state of the pipeline `table.SHORT`.
        wanted: a quality, or the seconds for the run.
        load: loads the other pipelines, which initialize in the same way.

    Raises:
        RunError: the budget is too small.
    """
    if not isinstance(wanted, Budget):
        choice = by_quality(wanted)
        chosen = _ready(choice.name, initial, load)
        _log_choice(chosen, choice.reason, initial, log)
        return chosen
    growth = _known_growth(initial)
    cost, measured = _cost(initial, wanted, growth)
    affordable = cost.iterations(wanted.seconds)
    choice = by_length(affordable / initial.pipeline.training.iterations)
    if choice.name != initial.pipeline.name:
        initial = initial.of(_ready(choice.name, initial, load))
        growth = _known_growth(initial)
        cost, measured = _cost(initial, wanted, growth)
        affordable = cost.iterations(wanted.seconds)
    cost.require(LEAST_ITERATIONS, wanted.seconds)
    count = min(affordable, round(choice.longest * initial.pipeline.training.iterations))
    chosen = _within_budget(initial.pipeline, count, growth)
    _log_choice(chosen, choice.reason, initial, log)
    _log_cost(cost, measured, count, wanted.seconds, log)
    return chosen


def _ready(name: str, initial: InitialState, load: Load) -> Pipeline:
    """Load a pipeline of the table for the number of training views."""
    if name == initial.pipeline.name:
        return initial.pipeline
    return load(name).for_views(len(initial.scene.train))


class _Growth(NamedTuple):
    """Mean and largest number of Gaussians during a run."""

    mean: int
    most: int


def _growth(pipeline: Pipeline, mean: float, most: float) -> _Growth:
    """Clamp to the pipeline's own limit."""
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
    """Scale the pipeline, limit its Gaussians, and turn off scores during training."""
    fitted = pipeline.scaled(count)
    changes = {"max_gaussians": growth.most, "evaluate_every": 0}
    return replace(fitted, training=fitted.training.model_copy(update=changes))


def _log_choice(chosen: Pipeline, reason: str, initial: InitialState, log: Log) -> None:
    """Log the pipeline, the scene and the reason in lines of at most 80 characters."""
    training, camera = chosen.training, initial.scene.train[0].camera
    most = f", at most {training.max_gaussians:,} Gaussians" if training.max_gaussians else ""
    log(f"trained: {chosen.name}, {training.iterations:,} iterations{most}")
    views = f"{counted(len(initial.scene.train), 'training view')} of {camera.width}x{camera.height} pixels"
    kind = initial.points.facts.get("scene_kind")
    log(f"  for     {views}" + (f", {kind}" if kind else ""))
    if reason:
        log(f"  because {reason}")


def _log_cost(cost: Cost, measured: Measured, count: int, seconds: float, log: Log) -> None:
    log(
        f"  measured {1000 * measured.iteration:.1f} ms an iteration with "
        f"{measured.gaussians:,} Gaussians"
    )
    log(
        f"  expected {cost.spent:.1f} s so far + {count * cost.iteration:.1f} s training + "
        f"{cost.after:.1f} s afterwards = {cost.seconds(count):.1f} s"
    )
    if cost.seconds(count) < 0.9 * seconds:
        log(f"  less than {seconds:g} s, because more iterations are not known to help")
