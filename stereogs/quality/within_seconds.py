"""Choose the pipeline and its length for a number of seconds.

A run within a number of seconds is never refused. In this order it takes settings with which its loader is
faster (`SceneLoader.within`), smaller photographs (`sizing`), the pipeline `table.QUICK`, and fewer
iterations, down to 30; then it ends late and says why. If the machine becomes slower during training,
training starts again with fewer iterations (`WithinSeconds.corrected`).
"""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from math import ceil
from time import monotonic, process_time
from typing import TYPE_CHECKING, NamedTuple

from registry import SceneLoader
from registry.calls.blame import blame
from registry.pipeline.pipeline import Pipeline
from registry.runs.preparation import Prepared
from registry.system.cores import usable_cores

from .fitting import HURRIED, Fit, Load, log_choice, pipeline_for_many, ready, with_loader
from .table import FOR_MANY, GROWTH, MANY_LEAST, SHORT, by_length

if TYPE_CHECKING:
    from registry.runs.run import Run

    from .rehearsal import Clock, Measured

MIN_ITERATIONS = 30
"""A run trains at least as many, however late it ends; a pipeline with fewer trains its own number."""
REHEARSED = 0.04
"""Share of the budget for timing iterations."""
GROWN = 100_000
"""Assumed final number of Gaussians for a pipeline of unknown growth, if it starts with fewer."""
CHECKED = (0.1, 0.25, 0.5)
"""Shares of the iterations after which the pace is compared with the measured one."""
TOLERATED = 1.1
"""Training starts again if it would end after this multiple of the budget."""
WORTHWHILE = 0.8
"""Training starts again only if that takes at most this share of the time for going on."""
FEW_PIXELS, FEW_ITERATIONS = 400, 100
"""A run with less on the longer side, or with fewer iterations, is reported as hurried."""
SHARE = 0.5
"""Share of the time left in which the loader should finish."""


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


@dataclass
class WithinSeconds(Fit):
    """Trains as long as a budget allows, and at least 30 iterations.

    Args:
        load: loads the ready pipelines for a choice among them, as in `WithQuality`; None: the given
            pipeline trains, at most its own number of iterations.
    """

    budget: Budget = field(kw_only=True)
    load: Load | None = None
    _measured: Measured | None = field(default=None, init=False)
    _began: float = field(default=0.0, init=False)
    _spent: float = field(default=0.0, init=False)
    _abandoned: float = field(default=0.0, init=False)
    _hastened: str = field(default="", init=False)

    def hastened(self, pipeline: Pipeline) -> Pipeline:
        """Leave the loader half of the time on all cores, except for settings of the command line."""
        loader = pipeline.one("scene")
        offered = loader.offer.component
        if self.load is None or not issubclass(offered, SceneLoader):
            return pipeline
        seconds = SHARE * self._cpu_seconds_left() * usable_cores()
        with blame(loader):
            settings = offered.within(loader.settings, seconds)
        before = dict(loader.settings)
        changes = {
            name: value
            for name, value in settings
            if value != before[name] and f"scene.{name}" not in self.kept
        }
        if changes:
            told = (f"{name}: {value} instead of {before[name]}" for name, value in changes.items())
            self._hastened = ", ".join(told)
            self.log(f"{self._hastened}: time is short")
        return with_loader(pipeline, changes)

    def _seconds_left(self) -> float:
        return self.budget.seconds - self.budget.spent

    def _cpu_seconds_left(self) -> float:
        """Return the seconds left at the rate at which the process has got CPU time so far."""
        return self._seconds_left() * min(1.0, process_time() / self.budget.spent)

    def fitted(self, initial: Prepared) -> Pipeline:
        """Return the best pipeline for the time left."""
        from .rehearsal import SharedState

        self._shared, reason, longest = SharedState(initial.parts), "", 1.0
        self._measure(initial, None if self.load is None else SHORT)
        if self.load is not None:
            affordable = self._affordable()
            choice = by_length(affordable / initial.pipeline.training.iterations)
            many = None
            if affordable >= MANY_LEAST:
                many = pipeline_for_many(initial, self.load, self.log)
            if many is not None:
                choice = FOR_MANY
            reason, longest = choice.reason, choice.longest
            if choice.name != SHORT:
                initial = initial.of(many or ready(choice.name, initial, self.load))
                self._measure(initial, choice.name, again=affordable >= MIN_ITERATIONS)
        most = round(longest * self._whole.training.iterations)
        self._least = min(MIN_ITERATIONS, most)
        count = max(self._least, min(self._affordable(), most))
        chosen = self._with_length(count)
        log_choice(chosen, reason, initial, self.log)
        self._log_cost(count)
        return chosen

    def hurried(self, initial: Prepared) -> str:
        """Return the size and length if one is below `FEW_PIXELS` or `FEW_ITERATIONS`, and a command."""
        camera, count = initial.scene.train[0].camera, initial.pipeline.training.iterations
        pixels = max(camera.width, camera.height)
        shrunk = self._shrunk and pixels < FEW_PIXELS
        shortened = count < min(FEW_ITERATIONS, self._whole.training.iterations)
        if not (shrunk or shortened or self._hastened):
            return ""
        better = "without --seconds it trains in full"
        path = getattr(initial.pipeline.one("scene").settings, "path", None)
        if self.load is not None and path is not None:
            command = f"stereogs train {shlex.quote(str(path))} --quality fast"
            better = f"for a better scene: {command}"
        return (
            f"hurried: --seconds {self.budget.seconds:g} left time for {pixels} pixels and {count} "
            f"iterations{self._hastened and f', {self._hastened}'}; {better}"
        )

    def _measure(self, initial: Prepared, ready: str | None, *, again: bool = True) -> None:
        """Consider a pipeline, and time it if there is time left and `again` is true.

        Args:
            ready: name in the table; None if the pipeline is not one of the table.
        """
        from .rehearsal import rehearse

        self._whole, budget = initial.pipeline, self.budget
        self._growth = _growth(initial, ready)
        if again and self._seconds_left() > 0:
            seconds = REHEARSED * budget.seconds
            self._measured = rehearse(initial, self._growth.mean, budget.clock, seconds)

    def _affordable(self) -> int:
        """The number of iterations that fit into the time left, at least 0."""
        if self._measured is None:
            return 0
        left = self._seconds_left() - self._measured.after
        return max(0, int(left / self._measured.iteration))

    def _with_length(self, count: int) -> Pipeline:
        """Scale the pipeline, limit its Gaussians, and turn off scores during training."""
        fitted = self._whole.scaled(count)
        changes = {"max_gaussians": self._growth.most, "evaluate_every": 0}
        return replace(fitted, training=fitted.training.model_copy(update=changes))

    def corrected(self, done: int, total: int) -> Pipeline | None:
        """Return the pipeline with fewer iterations if the machine has become too slow, otherwise None.

        After 10, 25 and 50 % of the iterations, the time for the others is extrapolated from the time
        so far. If training would end after 1.1 times the budget, it starts again with as many iterations as
        fit, at least 30, unless that takes more than four fifths of the time for going on.
        """
        self._spent = self.budget.spent
        if done == 1:
            self._began = self._spent
        measured, checked = self._measured, {ceil(share * total) for share in CHECKED} - {1}
        if measured is None or done not in checked:
            return None
        pace = (self._spent - self._began) / measured.seconds(1, done, total)
        going_on = pace * measured.seconds(done, total, total)
        left = self._seconds_left() - pace * measured.after
        if going_on <= left + (TOLERATED - 1) * self.budget.seconds:
            return None
        count = max(self._least, int(left / (pace * measured.iteration)))
        if count * pace * measured.iteration > WORTHWHILE * going_on:
            return None
        self.log(f"iterations take {pace:.1f} times as long as measured; training starts again")
        self.log(f"  with {count} iterations instead of {total}")
        self._abandoned += self._spent - self._began
        self._shared.restore()
        return self._with_length(count)

    def closing(self, run: Run) -> Iterator[str]:
        """Yield how long the finished run took, why it is late, and how to repeat it."""
        seconds = run.seconds
        took = self._spent + seconds.evaluation + seconds.outputs
        if took > self.budget.seconds:
            parts = {
                "photographs and cameras": seconds.scene,
                "first points": seconds.initialization,
                f"{run.iteration} iterations": seconds.training,
                "scores and files": seconds.evaluation + seconds.outputs,
            }
            if self._abandoned:
                parts["training before it started again"] = self._abandoned
            parts["start, and timing of iterations"] = took - sum(parts.values())
            yield f"late      took {took:.1f} s instead of {self.budget.seconds:g} s, because"
            yield from (f"          {name} took {value:.1f} s" for name, value in parts.items())
        if hurried := run.initialization.get(HURRIED):
            yield str(hurried)
        yield f"repeat    stereogs train {run.folder_or_refuse().pipeline}; it took {took:.1f} s"

    def _log_cost(self, count: int) -> None:
        measured, spent, seconds = self._measured, self.budget.spent, self.budget.seconds
        if measured is None:
            self.log(f"  {spent:.1f} s have passed, so the run takes longer than {seconds:g} s")
            return
        training = count * measured.iteration
        total = spent + training + measured.after
        self.log(
            f"  measured {1000 * measured.iteration:.1f} ms an iteration with "
            f"{measured.gaussians:,} Gaussians"
        )
        self.log(
            f"  expected {spent:.1f} s so far + {training:.1f} s training + "
            f"{measured.after:.1f} s afterwards = {total:.1f} s"
        )
        if total < 0.9 * seconds:
            self.log(f"  less than {seconds:g} s, because more iterations are not known to help")


class _Growth(NamedTuple):
    """Mean and largest number of Gaussians during a run."""

    mean: int
    most: int


def _growth(initial: Prepared, ready: str | None) -> _Growth:
    """Return the expected growth, within the pipeline's own limit.

    Args:
        ready: name in the table; None if the pipeline is not one of the table.
    """
    pipeline, first = initial.pipeline, len(initial.gaussians)
    if ready is not None:
        mean, most = (factor * first for factor in GROWTH[ready])
    else:
        most = max(first, GROWN) if pipeline.items["densification"] else first
        mean = (first + most) / 2
    limit = pipeline.training.max_gaussians or int(most)
    return _Growth(max(first, min(int(mean), limit)), max(1, min(int(most), limit)))
