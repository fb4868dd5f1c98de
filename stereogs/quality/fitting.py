"""Choose the size of the photographs, the pipeline and its length, from the scene and the time.

A run within a number of seconds is never refused. In this order it takes settings with which its loader is
faster (`SceneLoader.within`), smaller photographs (`sizing`), the pipeline `table.QUICK`, and fewer
iterations, down to 30; then it ends late and says why. If the machine becomes slower during training,
training starts again with fewer iterations (`WithinSeconds.corrected`). The run's pipeline records all
choices, so that it can be repeated.
"""

from __future__ import annotations

import shlex
import shutil
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from math import ceil
from time import monotonic, process_time
from typing import TYPE_CHECKING, NamedTuple

from registry import RunError, SceneLoader
from registry.calls.blame import blame
from registry.messages.suggestions import counted
from registry.pipeline.pipeline import Pipeline
from registry.runs.folder import ChooseFolder, refuse_occupied
from registry.runs.preparation import Prepared, load, prepare, running
from registry.runs.training_run import train_prepared
from registry.system.cores import usable_cores

from .table import GROWTH, SHORT, Quality, by_length, by_quality

if TYPE_CHECKING:
    from pathlib import Path

    from registry import Scene
    from registry.runs.options import RunOptions
    from registry.runs.run import Run
    from registry.training.trainer import Iteration

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
HURRIED = "hurried"
"""Name of the fact in results.json, which the report shows."""
FEW_PIXELS, FEW_ITERATIONS = 400, 100
"""A run with less on the longer side, or with fewer iterations, is reported as hurried."""
SHARE = 0.5
"""Share of the time left in which the loader should finish."""
NEARLY = 0.95
"""Photographs smaller than this multiple of the wanted size are reported; lenses crop a few pixels."""

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


@dataclass
class Fit:
    """Trains the given pipeline, on smaller photographs if memory is short.

    Subclasses choose the pipeline and its length. The pipeline of the run records all choices: training it
    alone gives the same bits.

    Args:
        log: receives lines of at most 80 characters.
        size: longer side of the photographs in pixels, if it is given.
        adapts_size: whether time and memory choose the size.
        kept: settings that the command line names, such as "scene.frames".
        device: part of the name of the OpenCL device.
    """

    log: Log
    size: int | None = None
    adapts_size: bool = False
    kept: Collection[str] = ()
    device: str | None = None
    _shrunk: bool = field(default=False, init=False)

    def train(
        self, pipeline: Pipeline, options: RunOptions, out: Path | ChooseFolder | None = None
    ) -> Run:
        """Train the pipeline that fits; arguments, answer and errors as for `start_run`."""
        refuse_occupied(out)
        with running(options) as active:
            pipeline = self.hastened(pipeline)
            loaded = load(pipeline, active)
            resized = self.resized(pipeline, loaded.scene)
            if resized is not pipeline:
                loaded = loaded.again(resized)
            initial = prepare(loaded, active)
            fitted = self.fitted(initial)
            if fitted is not initial.pipeline:
                initial = initial.of(fitted)
            return self._train(_noting(initial, self.hurried(initial)), active, out)

    def _train(
        self, initial: Prepared, options: RunOptions, out: Path | ChooseFolder | None
    ) -> Run:
        """Train to the end, or until `corrected` returns a pipeline, and then that one in the same folder."""
        total, corrections = initial.pipeline.training.iterations, list[Pipeline]()

        def watch(done: Iteration) -> bool:
            if options.callback is not None and options.callback(done) is False:
                return False
            corrected = self.corrected(done.number, total)
            corrections.extend([] if corrected is None else [corrected])
            return corrected is None

        run = train_prepared(initial, replace(options, callback=watch), out)
        if not corrections or run.interrupted:
            return run
        if run.folder is not None:
            out = run.folder.path
            shutil.rmtree(out)
        shorter = initial.of(corrections[0])
        return self._train(_noting(shorter, self.hurried(shorter)), options, out)

    def hastened(self, pipeline: Pipeline) -> Pipeline:
        """Return the pipeline with settings of the loader that take less time, if time is short."""
        return pipeline

    def resized(self, pipeline: Pipeline, scene: Scene) -> Pipeline:
        """Return the pipeline with smaller photographs if time or memory is short.

        Raises:
            RunError: a size is given, and the pipeline follows a protocol.
        """
        longer = max(max(view.camera.width, view.camera.height) for view in scene.train)
        if self.size is not None:
            if pipeline.protocol is not None:
                raise RunError(
                    f"the protocol {pipeline.protocol.protocol.name!r} fixes the size of the photographs",
                    where=f"--size {self.size}",
                    fix="leave --size out, or use no protocol: --set protocol=null",
                )
            if longer < NEARLY * self.size:
                self.log(f"the photographs have {longer} pixels and are not enlarged")
        loader = pipeline.one("scene")
        known = hasattr(loader.settings, "max_size") and pipeline.protocol is None
        if not self.adapts_size or not known:
            return pipeline
        from core_rasterizer import open_device

        from .sizing import smaller_size

        found = smaller_size(scene, self._cpu_seconds_left(), open_device(self.device))
        if found is None:
            return pipeline
        self._shrunk = True
        self.log(f"photographs: {found.pixels} pixels instead of {longer}: {found.reason} is short")
        self.log("  --size PIXELS chooses the longer side")
        return _with_loader(pipeline, {"max_size": found.pixels})

    def _cpu_seconds_left(self) -> float | None:
        """CPU seconds that the process can expect until the end of the budget; None: no limit."""
        return None

    def fitted(self, initial: Prepared) -> Pipeline:
        """Return the pipeline that trains, with the same scene, priors and initializer."""
        return initial.pipeline

    def hurried(self, initial: Prepared) -> str:
        """Return how little the time allowed, and the command for a better scene; "" if it was enough."""
        return ""

    def corrected(self, done: int, total: int) -> Pipeline | None:
        """Return a pipeline to start training again with, or None; called after each iteration.

        Args:
            done, total: the number of the iteration, and of the last one.
        """
        return None

    def closing(self, run: Run) -> Iterator[str]:
        """Yield what to report after a finished run."""
        return iter(())


@dataclass
class WithQuality(Fit):
    """Trains a folder with the pipeline of a quality.

    Args:
        load: loads the ready pipelines, which initialize in the same way; the given one is SHORT, perhaps
            with another name.
    """

    load: Load = field(kw_only=True)
    quality: Quality = "good"

    def fitted(self, initial: Prepared) -> Pipeline:
        """Return the pipeline of the quality for the number of training views."""
        choice = by_quality(self.quality)
        chosen = _ready(choice.name, initial, self.load)
        _log_choice(chosen, choice.reason, initial, self.log)
        return chosen

    def closing(self, run: Run) -> Iterator[str]:
        """Yield the command that repeats the run."""
        yield f"repeat    stereogs train {run.folder_or_refuse().pipeline}"


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
        return _with_loader(pipeline, changes)

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
            reason, longest = choice.reason, choice.longest
            if choice.name != SHORT:
                initial = initial.of(_ready(choice.name, initial, self.load))
                self._measure(initial, choice.name, again=affordable >= MIN_ITERATIONS)
        most = round(longest * self._whole.training.iterations)
        self._least = min(MIN_ITERATIONS, most)
        count = max(self._least, min(self._affordable(), most))
        chosen = self._with_length(count)
        _log_choice(chosen, reason, initial, self.log)
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


def _with_loader(pipeline: Pipeline, changes: Mapping[str, object]) -> Pipeline:
    """Return the pipeline with other settings of its loader."""
    loader = pipeline.one("scene")
    changed = replace(loader, settings=loader.settings.model_copy(update=dict(changes)))
    return replace(pipeline, items={**pipeline.items, "scene": (changed,)}) if changes else pipeline


def _noting(initial: Prepared, hurried: str) -> Prepared:
    """Return the state with the sentence among the facts that results and report show, or without one."""
    facts = {name: fact for name, fact in initial.points.facts.items() if name != HURRIED}
    facts |= {HURRIED: hurried} if hurried else {}
    return replace(initial, points=replace(initial.points, facts=facts))


def _ready(name: str, initial: Prepared, load: Load) -> Pipeline:
    """Load a pipeline of the table for the number of training views, with the scene as it was read."""
    if name == SHORT:
        return initial.pipeline
    loaded = load(name).for_views(len(initial.scene.train))
    return replace(loaded, items={**loaded.items, "scene": initial.pipeline.items["scene"]})


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


def _log_choice(chosen: Pipeline, reason: str, initial: Prepared, log: Log) -> None:
    """Log the pipeline, the scene and the reason in lines of at most 80 characters."""
    training, camera = chosen.training, initial.scene.train[0].camera
    log(f"trained: {chosen.name}, {training.iterations:,} iterations")
    log(f"  from    {_from(len(initial.gaussians), training.max_gaussians)}")
    views = f"{counted(len(initial.scene.train), 'training view')} of {camera.width}x{camera.height} pixels"
    kind = initial.points.facts.get("scene_kind")
    log(f"  for     {views}" + (f", {kind}" if kind else ""))
    if reason:
        log(f"  because {reason}")


def _from(first: int, limit: int | None) -> str:
    """Describe the growth; the limit bounds new Gaussians and removes none."""
    if limit is None:
        return f"{first:,} Gaussians"
    if first == limit:
        return f"{first:,} Gaussians, without growth"
    if first > limit:
        return f"{first:,} Gaussians, without growth: the limit of growth is {limit:,}"
    return f"{first:,} Gaussians, which grow to at most {limit:,}"
