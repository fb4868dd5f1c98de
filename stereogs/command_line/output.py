"""Output of several verbs: consoles, the table of scores, and the end of a run."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from registry.messages.terminal import PlainConsole
from registry.toolkit.progress.display import console_of_bar

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from registry.pipeline.parts import Part
    from registry.runs.folder import RunFolder
    from registry.runs.run import Run

FAILED = 1
"""Exit status if a metric, an exporter or a report failed after training."""
INTERRUPTED = 130
ABSENT = "\u2013"
"""Shown in tables if a score is not available: a dash."""


def console(*, stderr: bool = False) -> PlainConsole:
    """Return a console for the current standard output or standard error; the bar's, if one is shown."""
    shown = console_of_bar()
    if isinstance(shown, PlainConsole) and (not stderr or sys.stderr.isatty()):
        return shown
    return PlainConsole(stderr=stderr, markup=False, highlight=False, soft_wrap=True)


class LogLines(logging.Handler):
    """Prints log lines on standard error, the same line once."""

    def __init__(self) -> None:
        super().__init__()
        self._printed: set[str] = set()

    def emit(self, record: logging.LogRecord) -> None:
        """Print the line, unless it was printed before."""
        line = f"stereogs: {self.format(record)}"
        if line not in self._printed:
            self._printed.add(line)
            console(stderr=True).print(line)


def results_table(results: dict[str, Any]) -> Table:
    """Return the scores of a results.json as a table: one row per test view, then the means."""
    from rich.table import Table

    from registry.runs.results import score_of

    metrics = list(results["train"] | results["test"])
    missing: dict[str, str] = results["unavailable"]
    table = Table(
        title=f"{results['scene']['name']}, {results['pipeline']}",
        caption="\n".join(f"{ABSENT} {name}: {reason}" for name, reason in missing.items()) or None,
    )
    table.add_column("view")
    for name in metrics:
        table.add_column(name, justify="right")

    def cells(split: str, view: str | None = None) -> Iterator[str]:
        for name in metrics:
            score = score_of(results, split, name, view)
            if score is None:
                yield ABSENT
            else:
                yield f"{score:.4f}" if abs(score) < 1 else f"{score:.2f}"

    for view in results["views"]["test"]:
        table.add_row(view, *cells("test", view))
    table.add_section()
    for split in ("test", "train"):
        if results[split]:
            some = results.get("train_scored") if split == "train" else None
            table.add_row(f"{split} mean" + (f" of {some}" if some else ""), *cells(split))
    return table


def conclude(run: Run, output: Console) -> int:
    """Print how the run ended and the paths of its files; return the exit status."""
    from registry.runs.results import RENDERS

    folder = run.folder_or_refuse()
    if not run.finished:
        output.print(
            f"stopped; the checkpoint is complete. Continue with\n  stereogs resume {folder.shown()}"
        )
        return INTERRUPTED
    results: dict[str, Any] = folder.results()
    output.print(results_table(results), soft_wrap=False)
    if results["train"] and not results["test"]:
        output.print(
            "scores are of training photographs; --test-every 8 holds out every 8th to score new views"
        )
    memory = results["peak_memory_mb"]
    output.print(
        f"{results['gaussians']:,} Gaussians, {results['iterations']:,} iterations in "
        f"{results['seconds']:.0f} s ({results['iterations_per_second']:.1f} it/s)"
        + (f", at most {memory:.0f} MB" if memory is not None else "")
    )
    for file in results["exports"]:
        output.print(f"exported  {folder.shown(file)}")
    output.print(f"pictures  {folder.shown(RENDERS)}")
    for file in results["reports"]:
        output.print(f"page      {folder.shown(file)}")
    output.print(f"hash      {results['hash']}")
    return print_failures(results["failures"], folder.shown())


def report(run: Run, folder: RunFolder, reports: Sequence[Part]) -> int:
    """Write reports of a finished run, and print their files and failures; return the exit status."""
    from registry.runs.outputs import write_reports

    files, failures = write_reports(run, folder, reports)
    for file in files:
        console().print(f"page  {folder.path / file}")
    return print_failures([failure.model_dump() for failure in failures], folder.shown())


def print_failures(failures: Sequence[dict[str, str]], folder: str) -> int:
    """Print which metrics, exporters and reports failed; return the exit status."""
    output = console(stderr=True)
    for failure in failures:
        output.print(f"stereogs: {failure['component']}: {failure['what']}")
        for name in filter(failure.get, ("where", "fix")):
            output.print(f"  {name:<5}  {failure[name]}")
    if failures:
        output.print(
            "All other results are saved. After fixing it, score, export and report again:\n"
            f"  stereogs eval {folder}"
        )
    return FAILED if failures else 0
