"""The observers of a pipeline: told what happens in a run, each with the host's guards around the call."""

from __future__ import annotations

import copy
import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from core_rasterizer import ExplainedError

from ...calls.read_only_guard import of_scene
from ...events import RunEnded, RunStarted, ViewsScored
from ...pipeline.parts import Part
from ...training.trainer import Iteration, Trainer
from ..evaluation import Scores
from ..results import describe

if TYPE_CHECKING:
    from ..run import Run

FOLDER = "observers"
"""In the run folder, with a folder for each observer's files."""

_log = logging.getLogger(__name__)


@contextmanager
def observed(run: Run, trainer: Trainer, *, resumed: bool) -> Iterator[Observers]:
    """Within the block a run is trained, or goes on: observers hear its start, and how it ended.

    Raises:
        ExplainedError: an observer failed; the others have heard the end.
    """
    observers = Observers(run, trainer)
    try:
        observers.started(resumed=resumed)
        yield observers
    except Exception as error:
        observers.failed(error)
        raise
    observers.ended()


class Observers:
    """The observers of a run. Without any, all of this does nothing.

    Each is given values of its own: what one changes in them reaches nobody else.

    Args:
        run: what is told of.
        trainer: trains it.
    """

    def __init__(self, run: Run, trainer: Trainer) -> None:
        self._run, self._trainer = run, trainer
        self._parts = run.parts["observers"]
        self._listening: list[Part] = []

    def started(self, *, resumed: bool) -> None:
        """Tell each that the run begins, or goes on.

        Raises:
            ExplainedError: one failed.
        """
        if not self._parts:
            return
        scene = self._run.scene.for_training()
        facts, pipeline = describe(self._run), self._run.pipeline
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
            self._listening.append(part)

    def iterated(self, done: Iteration) -> None:
        """Tell those that are due of an iteration.

        Raises:
            ExplainedError: one failed.
        """
        field, seconds = self._trainer.fields[0], self._run.seconds.training
        for part in self._run.parts.due("observers", done.number):
            event = field.done(done.loss, done.logged, seconds)
            with part.at_work(done.number, field.lent):
                part.component.iterated(event)

    def evaluated(self, scores: Mapping[str, Scores]) -> None:
        """Tell each of scores, by split.

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

    def ended(self) -> None:
        """Tell each that training has come to its end, or was stopped.

        Raises:
            ExplainedError: some failed; it is the first one's.
        """
        errors = self._tell_end(None)
        if errors:
            raise errors[0]

    def failed(self, error: Exception) -> None:
        """Tell each what went wrong; what goes wrong with that is only warned of."""
        for second in self._tell_end(str(error)):
            _log.warning("%s (%s)", second.what, second.where)

    def _tell_end(self, error: str | None) -> list[ExplainedError]:
        """Tell those that have heard the start, once; what some of them raised."""
        listening, self._listening = self._listening, []
        run, errors = self._run, list[ExplainedError]()
        for part in listening:
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
