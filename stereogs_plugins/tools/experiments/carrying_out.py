"""What `ablate` and `bench` have in common: train what a plan lacks, write its table, tell how it ended."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from registry import RunError
from registry.commands import add_device, console

if TYPE_CHECKING:
    from rich.console import Console

    from registry.pipeline import Node
    from registry.plugins import Plugins

    from .planning.plan import Plan
    from .running.folder import AblationFolder
    from .running.runner import Outcome
    from .showing.scores import Results

INTERRUPTED = 130


def add_arguments(parser: argparse.ArgumentParser, default_folder: str) -> None:
    """Add what both verbs understand."""
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help=f"where to write (default: {default_folder})"
    )
    parser.add_argument(
        "--runner",
        metavar="NAME",
        help="who trains: local, another one's name, or {use: NAME, setting: value}",
    )
    parser.add_argument(
        "--jobs",
        type=int,
        metavar="N",
        help="trainings at the same time (default: as cores and memory allow; 1 on a GPU)",
    )
    add_device(parser)


def carry_out(
    arguments: argparse.Namespace, plan: Plan, runner: Node | None, plugins: Plugins
) -> int:
    """Train what is missing, then write and print the table; 130 after Ctrl-C.

    Args:
        runner: who trains, if the command line does not say.
    """
    if arguments.jobs is not None and arguments.jobs < 1:
        raise RunError(
            f"{arguments.jobs} trainings at the same time are too few",
            where="--jobs",
            fix="give 1 or more, or leave it out",
        )
    from core_rasterizer import open_device

    from .running.choosing import choose_runner
    from .running.folder import AblationFolder
    from .running.local_processes import LocalProcesses
    from .running.runner import train_all

    output, device = console(), open_device(arguments.device)
    crew = choose_runner(_runner(arguments, runner), arguments.jobs, plugins, device)
    folder = AblationFolder(arguments.out or Path("runs", f"{plan.kind}-{plan.name}"))
    with folder.locked() as lock:
        results = {run: folder.results(run) for run in plan.runs}
        waiting = [run for run in plan.runs if not results[run]]
        if isinstance(crew.component, LocalProcesses):
            peaks = [found.get("peak_memory_mb") or 0.0 for found in results.values() if found]
            crew.component.lock, crew.component.peaks_mb = lock, peaks
        with crew.at_work():
            places = crew.component.places
        output.print(
            f"{plan.size}, {len(plan.runs) - len(waiting)} of them finished; "
            f"{'all' if places is None else places} at a time by {crew.item.name} "
            f"on {device.name}; writing {folder.path}"
        )
        outcome = train_all(waiting, folder, crew, device=arguments.device, console=output)
        results = {run: folder.results(run) for run in plan.runs}
        _write(plan, results, folder)
    return _conclude(plan, results, folder, outcome, output)


def _runner(arguments: argparse.Namespace, written: Node | None) -> Node | None:
    if arguments.runner is None:
        return written
    from registry.pipeline import parse

    return parse(arguments.runner, f"--runner {arguments.runner}", has_lines=False)


def _files(plan: Plan) -> tuple[str, str, str]:
    return f"{plan.kind}.txt", f"{plan.kind}.csv", "index.html"


def _write(plan: Plan, results: Results, folder: AblationFolder) -> None:
    from registry.system import write_text

    from .published import published_costs
    from .showing.page import as_page
    from .showing.table import as_csv, as_text

    text, rows, page = _files(plan)
    write_text(folder.path / text, as_text(plan, results))
    write_text(folder.path / rows, as_csv(plan, results, folder))
    write_text(folder.path / page, as_page(plan, results, folder, published_costs(plan)))


def _conclude(
    plan: Plan, results: Results, folder: AblationFolder, outcome: Outcome, output: Console
) -> int:
    """Print the table and how it ended; returns the exit status."""
    from .showing.table import as_text

    output.print(as_text(plan, results), end="")
    for name in _files(plan):
        output.print(f"written  {folder.path / name}")
    if outcome.stopped:
        finished = sum(bool(found) for found in results.values())
        output.print(
            f"stopped; {finished} of {len(plan.runs)} runs are finished. "
            "The same command goes on from here."
        )
        return INTERRUPTED
    if outcome.failures:
        first, said = next(iter(outcome.failures.items()))
        raise RunError(
            f"{len(outcome.failures)} of {len(plan.runs)} runs failed; the first one said:\n{said}",
            where=str(folder.run(first).path.with_name(f"{folder.run(first).path.name}.log")),
            fix="mend the cause; the same command then trains what is missing",
        )
    return 0
