"""Many trainings and the tables of their records.

Each training adds a record to `benchmarks/records/NAME.jsonl`. A training that has a record of the same
pipeline is skipped, so the same command continues where it stopped, also on another machine. A change of the
code is not detected; remove records to measure again. Tables are written from the records present, even
if some are missing.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Generic

from rich.console import Console

from benchmarks import records
from benchmarks.pages import DOCS, marks, rewrite, write_tables
from benchmarks.records import Record
from benchmarks.training_process import ANSWER, PIPELINE
from benchmarks.trainings import AnyTraining, MeasuredProcesses, Training, check_data
from core_rasterizer import open_device
from core_rasterizer.errors import ExplainedError
from registry import RunError
from registry.discovery import Plugins
from registry.runners import TrainingTask
from registry.system.files import write_text
from registry.system.lock import locked
from stereogs.experiments.running.pool import Outcome, choose_runner, train_all

OUT = Path(__file__).parent / "out"
INTERRUPTED = 130


@dataclass(frozen=True)
class CampaignFolder:
    """Folders of a campaign's trainings, and the file that keeps its records.

    Args:
        path: A folder with a subfolder for each training: pipeline, log, pictures and answer.
        kept: File of records.
    """

    path: Path
    kept: Path

    def task(self, run: Training, device: str | None) -> TrainingTask:
        """Write the pipeline to train, and return the task."""
        folder = self.path / run.name
        folder.mkdir(parents=True, exist_ok=True)
        (folder / ANSWER).unlink(missing_ok=True)
        write_text(folder / PIPELINE, run.measured_pipeline)
        return TrainingTask(run.measured_pipeline, folder, folder / "log.txt", device)

    def keep(self, run: Training) -> bool:
        """Save a record of the answer of a training; return False if it left none."""
        answer = self.path / run.name / ANSWER
        if not answer.is_file():
            return False
        records.save(run, json.loads(answer.read_text("utf-8")), self.kept)
        return True

    def train(
        self, waiting: Sequence[AnyTraining], jobs: int, device: str | None, console: Console
    ) -> Outcome[AnyTraining]:
        """Train in order, and save a record of each training when it ends."""
        runner = choose_runner(None, jobs, Plugins(()), open_device(device), MeasuredProcesses)
        with locked(self.path) as lock:
            runner.component.lock = lock.descriptor
            return train_all(waiting, self, runner, device=device, console=console)


def _check_priors(waiting: Sequence[Training]) -> None:
    """Check that no training would use the fallback of a prior, which its row in a table does not name.

    Raises:
        RunError: the files of a preferred prior are missing.
    """
    for run in waiting:
        for prior in run.pipeline.items["priors"]:
            if prior.fallback:
                fix = "set STEREOGS_MODELS to the folder of the model files"
                raise RunError(
                    f"a fallback replaces a prior: {prior.fallback}", where=run.name, fix=fix
                )


@dataclass(frozen=True)
class Campaign(Generic[AnyTraining]):
    """A plan of trainings and the tables made from it.

    Args:
        name: Name of its records, tables and folder of outputs.
        title: Heading of its file of tables.
        data: Data sets that it needs.
        plan: Returns all trainings, in order.
        tables: Makes all tables from the records and the number of planned trainings.
        page: Page in `docs` that shows the summary, between marks; None: no page.
        summary: Makes the summary from the records.
        finish: Called at the end with the records and the folder of outputs.
        picture: Draws the records into a folder: that of outputs, or that of `docs`.
        target: Target of the Makefile.
    """

    name: str
    title: str
    data: Sequence[str]
    plan: Callable[[Plugins], list[AnyTraining]]
    tables: Callable[[Sequence[Record[AnyTraining]], int], str]
    page: str | None = None
    summary: Callable[[Sequence[Record[AnyTraining]]], str] | None = None
    finish: Callable[[Sequence[Record[AnyTraining]], Path], None] | None = None
    picture: Callable[[Sequence[Record[AnyTraining]], Path], None] | None = None
    target: str = ""

    def main(self, description: str | None) -> int:
        """Train the missing runs and write the tables; return the exit status."""
        arguments = self._arguments(description)
        console = Console(markup=False, highlight=False, soft_wrap=True)
        try:
            return self._run(arguments, console)
        except ExplainedError as error:
            sys.exit(f"{self.name}: {error}")

    def _arguments(self, description: str | None) -> argparse.Namespace:
        parser = argparse.ArgumentParser(description=description)
        parser.add_argument("--device", help="part of a device's name")
        parser.add_argument("--jobs", type=int, default=1, help="trainings at a time (%(default)s)")
        parser.add_argument("--finished", action="store_true", help="use only records that exist")
        parser.add_argument(
            "--write-docs", action="store_true", help="rewrite the tables and the page"
        )
        return parser.parse_args()

    def _run(self, arguments: argparse.Namespace, console: Console) -> int:
        folder = CampaignFolder(OUT / self.name, records.RECORDS / f"{self.name}.jsonl")
        if not arguments.finished:
            check_data(self.data)
        runs, failures = self.plan(Plugins()), {}
        done = {record.run.name for record in records.read(runs, folder.kept)}
        waiting = [run for run in runs if run.name not in done]
        console.print(f"{len(runs)} runs, {len(waiting)} to train")
        if not arguments.finished:
            _check_priors(waiting)
            folder.path.mkdir(parents=True, exist_ok=True)
            failures = folder.train(waiting, arguments.jobs, arguments.device, console).failures
        found = records.read(runs, folder.kept)
        text = self.tables(found, len(runs))
        console.print(text)
        if arguments.write_docs and found:
            self.write_docs(found, text)
        if self.finish is not None:
            self.finish(found, folder.path)
        if self.picture is not None and found:
            self.picture(found, DOCS / "images" if arguments.write_docs else folder.path)
        if failures:
            run, message = next(iter(failures.items()))
            raise RunError(
                f"{len(failures)} runs failed; the first error:\n{message}", where=run.name
            )
        if len(found) < len(runs):
            console.print(f"{len(runs) - len(found)} are missing; the same command continues")
            return INTERRUPTED
        return 0

    def write_docs(self, found: Sequence[Record[AnyTraining]], text: str) -> None:
        """Write the file of tables, and the summary into its page."""
        target = self.target or self.name
        write_tables(self.name, self.title, target, text)
        if self.page is not None and self.summary is not None:
            rewrite(DOCS / self.page, marks(target), self.summary(found))
