"""Many trainings and the page of their records: what `benchmarks.methods`, `.parts` and `.results` share.

Each training leaves a record in `benchmarks/records`, in the repository; what has one of the same pipeline
is not trained again, so that the same command goes on where it was stopped, on another day too. A change
of the code is not seen; remove records to measure anew. The page is written from the records that are
there, also while some are missing.
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
from benchmarks.marked_page import rewrite
from benchmarks.planned_training import Planned
from benchmarks.results_plan import check_data
from benchmarks.training_records import Record
from benchmarks.trainings import train
from core_rasterizer.errors import ExplainedError
from registry import RunError
from registry.plugins import Plugins

OUT = Path(__file__).parent / "out"
DOCS = Path(__file__).parent.parent / "docs"
INTERRUPTED = 130


def one_by_one(waiting: Sequence[Planned]) -> list[tuple[Planned]]:
    """Each training in a process of its own."""
    return [(run,) for run in waiting]


@dataclass(frozen=True)
class Campaign(Generic[Planned]):
    """What is trained, and what becomes of it.

    Args:
        name: of its command and folders.
        data: the data sets that it needs.
        plan: all trainings, in their order.
        page: its page's file in docs.
        marks: what stands around the measured part of the page.
        text: that part, from the records that are there and the number of those planned.
        look: done with these records in the end, pictures among it.
        together: puts those that are to be trained into groups that share a beginning.
    """

    name: str
    data: Sequence[str]
    plan: Callable[[Plugins], list[Planned]]
    page: str
    marks: tuple[str, str]
    text: Callable[[Sequence[Record[Planned]], int], str]
    look: Callable[[Sequence[Record[Planned]], Path], None] | None = None
    together: Callable[[Sequence[Planned]], Sequence[Sequence[Planned]]] = one_by_one

    def main(self, description: str | None) -> int:
        """Train what is missing as the command line says, and write the page; the exit status."""
        arguments = self._arguments(description)
        console = Console(markup=False, highlight=False, soft_wrap=True)
        try:
            return self._carry_out(arguments, console)
        except ExplainedError as error:
            sys.exit(f"{self.name}: {error}")

    def _arguments(self, description: str | None) -> argparse.Namespace:
        parser = argparse.ArgumentParser(description=description)
        parser.add_argument("--device", help="part of a device's name")
        parser.add_argument("--jobs", type=int, default=1, help="trainings at a time (%(default)s)")
        parser.add_argument("--seconds", type=float, help="begin no other training after so long")
        parser.add_argument(
            "--write-docs", action="store_true", help=f"rewrite the tables in {self.page}"
        )
        return parser.parse_args()

    def _carry_out(self, arguments: argparse.Namespace, console: Console) -> int:
        check_data(self.data)
        runs, kept, out = self.plan(Plugins()), records.RECORDS / self.name, OUT / self.name
        done = {record.run.name for record in records.read(runs, kept)}
        waiting = [run for run in runs if run.name not in done]
        console.print(f"{len(runs)} runs, {len(waiting)} to train")
        failures = train(
            self.together(waiting),
            jobs=arguments.jobs,
            seconds=arguments.seconds,
            device=arguments.device,
            out=out,
            kept=kept,
            console=console,
        )
        found = records.read(runs, kept)
        text = self.text(found, len(runs))
        console.print(text)
        if arguments.write_docs:
            rewrite(DOCS / self.page, *self.marks, text)
        if self.look is not None:
            self.look(found, out)
        if failures:
            name, said = next(iter(failures.items()))
            raise RunError(f"{len(failures)} runs failed; the first one said:\n{said}", where=name)
        if len(found) < len(runs):
            console.print(f"{len(runs) - len(found)} are missing; the same command goes on")
            return INTERRUPTED
        return 0
