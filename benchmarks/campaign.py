"""Many trainings and the tables of their records.

Each training adds a record to `benchmarks/records/NAME.jsonl`. A training that has a record of the same
pipeline is skipped, so the same command continues where it stopped, also on another machine. A change of the
code is not detected; remove records to measure again. Tables are written from the records present, even
if some are missing.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Generic

from rich.console import Console

from benchmarks import training_records as records
from benchmarks.pages import DOCS, marks, rewrite, write_tables
from benchmarks.planned_training import Planned
from benchmarks.results_plan import check_data
from benchmarks.training_records import Record
from benchmarks.trainings import train
from core_rasterizer.errors import ExplainedError
from registry import RunError
from registry.discovery import Plugins
from registry.system.lock import locked

OUT = Path(__file__).parent / "out"
INTERRUPTED = 130


def one_by_one(waiting: Sequence[Planned]) -> list[tuple[Planned]]:
    """Put each training into a process of its own."""
    return [(run,) for run in waiting]


def _check_priors(waiting: Sequence[Planned]) -> None:
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
class Campaign(Generic[Planned]):
    """A plan of trainings and the tables made from it.

    Args:
        name: Target of the Makefile; name of its records, tables and folder of outputs.
        title: Heading of its file of tables.
        data: Data sets that it needs.
        plan: Returns all trainings, in order.
        page: Page in `docs` that shows the summary, between marks.
        summary: Makes the summary from the records.
        tables: Makes all tables from the records and the number of planned trainings.
        finish: Called at the end with the records and the folder of outputs.
        group: Groups trainings whose first iterations are the same, to be computed once.
    """

    name: str
    title: str
    data: Sequence[str]
    plan: Callable[[Plugins], list[Planned]]
    page: str
    summary: Callable[[Sequence[Record[Planned]]], str]
    tables: Callable[[Sequence[Record[Planned]], int], str]
    finish: Callable[[Sequence[Record[Planned]], Path], None] | None = None
    group: Callable[[Sequence[Planned]], Sequence[Sequence[Planned]]] = one_by_one

    def main(self, description: str | None) -> int:
        """Train the missing runs and write the tables; return the exit status."""
        arguments = self._arguments(description)
        console = Console(markup=False, highlight=False, soft_wrap=True)
        out = OUT / self.name
        try:
            out.mkdir(parents=True, exist_ok=True)
            with locked(out):
                return self._run(arguments, out, console)
        except ExplainedError as error:
            sys.exit(f"{self.name}: {error}")

    def _arguments(self, description: str | None) -> argparse.Namespace:
        parser = argparse.ArgumentParser(description=description)
        parser.add_argument("--device", help="part of a device's name")
        parser.add_argument("--jobs", type=int, default=1, help="trainings at a time (%(default)s)")
        parser.add_argument("--seconds", type=float, help="start no training after this time")
        parser.add_argument(
            "--write-docs", action="store_true", help=f"rewrite the tables and {self.page}"
        )
        return parser.parse_args()

    def _run(self, arguments: argparse.Namespace, out: Path, console: Console) -> int:
        check_data(self.data)
        runs, kept = self.plan(Plugins()), records.RECORDS / f"{self.name}.jsonl"
        done = {record.run.name for record in records.read(runs, kept)}
        waiting = [run for run in runs if run.name not in done]
        _check_priors(waiting)
        console.print(f"{len(runs)} runs, {len(waiting)} to train")
        failures = train(
            self.group(waiting),
            jobs=arguments.jobs,
            seconds=arguments.seconds,
            device=arguments.device,
            out=out,
            kept=kept,
            console=console,
        )
        found = records.read(runs, kept)
        text = self.tables(found, len(runs))
        console.print(text)
        if arguments.write_docs:
            write_tables(self.name, self.title, self.name, text)
            rewrite(DOCS / self.page, marks(self.name), self.summary(found))
        if self.finish is not None:
            self.finish(found, out)
        if failures:
            name, message = next(iter(failures.items()))
            raise RunError(f"{len(failures)} runs failed; the first error:\n{message}", where=name)
        if len(found) < len(runs):
            console.print(f"{len(runs) - len(found)} are missing; the same command continues")
            return INTERRUPTED
        return 0
