"""Calls to the observers of a pipeline, each with the host's checks around it."""

from __future__ import annotations

import copy
import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from core_rasterizer import ExplainedError

from ..calls.read_only_guard import of_scene
from ..events import RunEnded, RunStarted, ViewsScored
from ..pipeline.parts import Part
from ..training.trainer import Iteration, Trainer
from .evaluation import Scores
from .run import Run

FOLDER = "observers"
"""Folder in the run folder, with a folder for the files of each observer."""

_log = logging.getLogger(__name__)


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
    errors = observers.ended(None)
    if errors:
        raise errors[0]


class Observers:
    """The observers of a run. Each receives copies, so that changes do not affect the others."""

    def __init__(self, run: Run, trainer: Trainer) -> None:
        self._run, self._trainer = run, trainer
        self._parts = run.parts["observers"]
        self._started: list[Part] = []

    def started(self, *, resumed: bool) -> None:
        """Notify each that the run begins or is resumed.

        Raises:
            ExplainedError: one failed.
        """
        if not self._parts:
            return
        scene = self._run.scene.for_training()
        facts, pipeline = self._run.describe().plain(), self._run.pipeline
        for part in self._parts:
            event = RunStarted(
                title=self._run.folder.path.name if self._run.folder else pipeline.name,
                folder=self._folder(part),
                identity=self._run.identity,
                iteration=self._run.iteration,
                resumed=resumed,
                iterations=pipeline.training.iterations,
                pipeline=pipeline.plain(),
                facts=copy.deepcopy(facts),
                scene=scene,
            )
            with part.at_work(lent=of_scene(scene)):
                part.component.started(event)
            self._started.append(part)

    def iterated(self, done: Iteration) -> None:
        """Notify those that are due of a complete iteration.

        Raises:
            ExplainedError: one failed.
        """
        field, seconds = self._trainer.fields[0], self._run.seconds.training
        for part in self._run.parts.due("observers", done.number):
            event = field.done(done.loss, done.logged, seconds)
            with part.at_work(done.number, field.lent):
                part.component.iterated(event)

    def evaluated(self, scores: Mapping[str, Scores]) -> None:
        """Notify each of scores, by split.

        Raises:
            ExplainedError: one failed.
        """
        for part in self._parts:
            event = ViewsScored(
                iteration=self._run.iteration,
                mean={split: of_split.mean for split, of_split in scores.items()},
                views={split: copy.deepcopy(of_split.views) for split, of_split in scores.items()},
            )
            with part.at_work():
                part.component.evaluated(event)

    def ended(self, error: str | None) -> list[ExplainedError]:
        """Notify each that was notified of the start, once; return the errors that they raise.

        Args:
            error: the error that ended the training, or None.
        """
        started, self._started = self._started, []
        run, errors = self._run, list[ExplainedError]()
        for part in started:
            complete = run.finished and error is None
            results = run.folder.results() if run.folder and complete else None
            event = RunEnded(run.iteration, run.finished, results, error)
            try:
                with part.at_work():
                    part.component.ended(event)
            except ExplainedError as wrong:
                errors.append(wrong)
        return errors

    def _folder(self, part: Part) -> Path | None:
        kept_in = self._run.folder
        return kept_in.folder(f"{FOLDER}/{part.item.name}") if kept_in else None
