"""Reports of a training: its stage, metrics.jsonl, and calls to observers."""

from __future__ import annotations

import copy
import logging
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from core_rasterizer import ExplainedError

from ..calls.copies import copied
from ..events import RunEnded, RunStarted, ViewsScored
from ..pipeline.parts import Part
from ..system.files import jsonable
from ..toolkit.progress.stages import STAGES, Stage, progress
from ..training.trainer import Iteration, Trainer
from .evaluation import Scores
from .results import describe
from .run import Run

EVERY = 50
"""Iterations that share a line of metrics.jsonl."""
OBSERVERS = "observers"
"""Folder in the run folder, with a folder for the files of each observer."""
_GROWTH = 1.3
"""An iteration takes up to twice as long at the end, with more Gaussians and larger images."""
_SMOOTHING = 0.05
"""Weight of the newest loss in the shown one: the losses of single views differ too much."""

Sums = dict[str, tuple[float, int]]
SUMS = "sums"
"""Prefix of `MetricsLog.sums` in checkpoints."""
_log = logging.getLogger(__name__)


class TrainingProgress:
    """The stage "training", with loss, number of Gaussians and iterations per second.

    Args:
        first, total: the last iteration before training, and the last one.
    """

    def __init__(self, first: int, total: int) -> None:
        self._first, self._loss, self._gaussians = first, math.nan, 0
        self.stage = Stage("training", first, total, STAGES.clock())
        self.stage.growth, self.stage.detail = _GROWTH, self._detail

    def update(self, done: Iteration) -> None:
        """Report a complete iteration."""
        before = done.loss if math.isnan(self._loss) else self._loss
        self._loss = before + _SMOOTHING * (done.loss - before)
        self._gaussians = done.gaussians
        progress(self.stage.name, done.number, self.stage.total)

    def _detail(self) -> str:
        stage = self.stage
        if stage.done == self._first:
            return ""
        speed = (stage.done - self._first) / max(stage.latest - stage.began, 1e-9)
        return f"loss {self._loss:.4f}  {self._gaussians:,} Gaussians  {speed:.1f} it/s"


class MetricsLog:
    """Averages the numbers of iterations into lines of metrics.jsonl.

    Args:
        write_line: receives each line.
        sums: sum and count of each number since the last line; changed in place.
    """

    def __init__(self, write_line: Callable[[dict[str, Any]], None], sums: Sums) -> None:
        self._write_line, self.sums = write_line, sums

    def add(self, done: Iteration, seconds: float, *, last: bool) -> None:
        """Add an iteration after `seconds` of training; write a line in every 50th and in the last."""
        for name, value in {"loss": done.loss, **done.logged}.items():
            total, count = self.sums.get(name, (0.0, 0))
            self.sums[name] = (total + value, count + 1)
        if last or done.number % EVERY == 0:
            means = {name: total / count for name, (total, count) in self.sums.items()}
            self.sums.clear()
            line = {"iteration": done.number, "seconds": round(seconds, 3)}
            self.write({**line, "gaussians": done.gaussians, **means})

    def write(self, line: dict[str, Any]) -> None:
        """Write a line; infinite and NaN become null."""
        self._write_line(jsonable(line))


@contextmanager
def observed(run: Run, trainer: Trainer, *, resumed: bool) -> Iterator[Observers]:
    """Notify observers of the start of a run, and of its end after the block.

    Raises:
        ExplainedError: an observer failed; the others are still notified of the end.
    """
    observers = Observers(run, trainer)
    try:
        observers.started(resumed=resumed)
        yield observers
    except Exception as error:
        for second in observers.ended(str(error)):
            _log.warning("%s (%s)", second.what, second.where)
        raise
    failures = observers.ended(None)
    if failures:
        raise failures[0]


class Observers:
    """The observers of a run. Each receives copies, so that changes do not affect the others.

    The methods raise an `ExplainedError` if an observer failed; `ended` returns it.
    """

    def __init__(self, run: Run, trainer: Trainer) -> None:
        self._run, self._trainer = run, trainer
        self._parts = run.parts["observers"]
        self._started: list[Part] = []

    def started(self, *, resumed: bool) -> None:
        """Notify each that the run begins or is resumed."""
        if not self._parts:
            return
        run, scene = self._run, self._run.trained_on.for_training()
        facts = describe(run).plain()
        for part in self._parts:
            event = RunStarted(
                title=run.folder.path.name if run.folder else run.pipeline.name,
                folder=run.folder.folder(f"{OBSERVERS}/{part.item.name}") if run.folder else None,
                identity=run.identity,
                iteration=run.iteration,
                resumed=resumed,
                iterations=run.pipeline.training.iterations,
                pipeline=run.pipeline.plain(),
                facts=copy.deepcopy(facts),
                scene=copied(scene),
            )
            with part.at_work():
                part.component.started(event)
            self._started.append(part)

    def iterated(self, done: Iteration) -> None:
        """Notify those that are due of a complete iteration."""
        field, seconds = self._trainer.fields[0], self._run.seconds.training
        for part in self._run.parts.due("observers", done.number):
            event = copied(field.done(done.loss, done.logged, seconds))
            with part.at_work(done.number):
                part.component.iterated(event)

    def evaluated(self, scores: Mapping[str, Scores]) -> None:
        """Notify each of scores, by split."""
        for part in self._parts:
            event = ViewsScored(
                iteration=self._run.iteration,
                mean={split: of_split.mean for split, of_split in scores.items()},
                views={split: copy.deepcopy(of_split.views) for split, of_split in scores.items()},
            )
            with part.at_work():
                part.component.evaluated(event)

    def ended(self, error: str | None) -> list[ExplainedError]:
        """Notify each that was started, once, of the end, and of its error if any; return their errors."""
        started, self._started = self._started, []
        run, errors = self._run, list[ExplainedError]()
        complete = run.finished and error is None
        for part in started:
            results = run.folder.results() if run.folder and complete else None
            try:
                with part.at_work():
                    part.component.ended(RunEnded(run.iteration, run.finished, results, error))
            except ExplainedError as failure:
                errors.append(failure)
        return errors
