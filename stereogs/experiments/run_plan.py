"""Train the unfinished runs of a plan and write its table, for the verbs `ablate` and `bench`."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from registry import RunError
from registry.toolkit.progress.display import showing

from ..command_line.arguments import add_device
from ..command_line.output import console

if TYPE_CHECKING:
    from rich.console import Console

    from core_rasterizer import Device
    from registry.discovery import Plugins
    from registry.pipeline.yaml_source import Node

    from .planning.plan import Plan, PlannedRun
    from .running.folder import ExperimentFolder, Peer, Shard
    from .running.pool import Outcome
    from .running.queue import Queue
    from .showing.scores import Results

INTERRUPTED = 130


def add_arguments(parser: argparse.ArgumentParser, default_folder: str) -> None:
    """Add the options of both verbs."""
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help=f"the folder to write (default: {default_folder})"
    )
    parser.add_argument(
        "--runner",
        metavar="NAME",
        help="where to train: local, the name of another runner, or {use: NAME, setting: value}",
    )
    parser.add_argument(
        "--jobs",
        type=int,
        metavar="N",
        help="simultaneous trainings (default: as many as cores and memory allow; 1 on a GPU)",
    )
    parts = parser.add_mutually_exclusive_group()
    parts.add_argument(
        "--shared",
        action="store_true",
        help="share the runs with processes of the same command, on other machines too if --out is on a "
        "shared file system; each takes free runs, and those of dead processes",
    )
    parts.add_argument(
        "--shard",
        type=shard,
        metavar="I/N",
        help="train the I-th of N parts of the runs, for example on one of N machines; they may share --out, "
        "or their `runs` folders are copied into one; without --shard the command then writes the table",
    )
    add_device(parser)


def shard(text: str) -> Shard:
    """Read I/N, for argparse."""
    from .running.folder import Shard

    number, _, parts = text.partition("/")
    if not (number.isdecimal() and parts.isdecimal() and 1 <= int(number) <= int(parts)):
        raise argparse.ArgumentTypeError(f"expected I/N with I from 1 to N, not {text!r}")
    return Shard(int(number), int(parts))


def run_plan(
    arguments: argparse.Namespace, plan: Plan, runner: Node | None, plugins: Plugins
) -> int:
    """Train unfinished runs, then write and print the table; return 130 after Ctrl-C.

    The option --runner replaces the `runner` of the file.
    """
    if arguments.jobs is not None and arguments.jobs < 1:
        raise RunError(
            f"--jobs must be at least 1, not {arguments.jobs}",
            where="--jobs",
            fix="give 1 or more, or remove the option",
        )
    from core_rasterizer import open_device
    from registry.pipeline.yaml_source import parse

    from .running.folder import ExperimentFolder, Peer
    from .running.local_processes import LocalProcesses
    from .running.pool import choose_runner, train_all

    if arguments.runner is not None:
        runner = parse(arguments.runner, f"--runner {arguments.runner}", has_lines=False)
    output, device = console(), open_device(arguments.device)
    part = choose_runner(runner, arguments.jobs, plugins, device)
    folder = ExperimentFolder(arguments.out or Path("runs", f"{plan.kind}-{plan.name}"))
    part_of_runs: Shard | None = arguments.shard
    mine = plan.runs if part_of_runs is None else part_of_runs.of(plan.runs)
    peer = Peer.here() if arguments.shared else None
    with folder.locked(peer or part_of_runs) as lock:
        results = {run: folder.results(run) for run in plan.runs}
        waiting = [run for run in mine if not results[run]]
        if isinstance(part.component, LocalProcesses):
            peaks = [found.get("peak_memory_mb") or 0.0 for found in results.values() if found]
            part.component.lock, part.component.peaks_mb = lock, peaks
        with part.at_work():
            places = part.component.places
        output.print(
            f"{plan.size}, {sum(map(bool, results.values()))} finished; "
            f"{f'{len(waiting)} to train; ' if part_of_runs else ''}"
            f"{'all' if places is None else places} at a time with the runner {part.item.name} "
            f"on {device.name}; writing {folder.path}"
        )
        with _queue(waiting, folder, peer, device, plugins) as queue:
            outcome = train_all(queue, folder, part, device=arguments.device, console=output)
        results = {run: folder.results(run) for run in plan.runs}
        _write(plan, results, folder, output)
    return _exit_status(plan, results, folder, outcome, output)


@contextmanager
def _queue(
    waiting: Sequence[PlannedRun],
    folder: ExperimentFolder,
    peer: Peer | None,
    device: Device,
    plugins: Plugins,
) -> Iterator[Queue[PlannedRun]]:
    """Yield the queue of a process; `peer` if it shares the folder, otherwise all scenes are loaded first.

    A scene that is not on this machine may be on another.
    """
    from .running.queue import Queue, shared
    from .running.scene_check import check_scenes

    if peer is not None:
        with shared(waiting, folder, peer) as queue:
            yield queue
        return
    output = console()
    with showing(output):
        doubts = check_scenes(waiting, device, plugins)
    for doubt in doubts:
        output.print(f"warning: {doubt}")
    yield Queue(waiting)


def _write(plan: Plan, results: Results, folder: ExperimentFolder, output: Console) -> None:
    """Write the tables as text, LaTeX, CSV and HTML, and print the text and the paths."""
    from registry.system.files import write_text

    from .showing.against_time import published_costs
    from .showing.page import as_page
    from .showing.table import as_csv, as_latex, as_text, means_as_csv

    text = as_text(plan, results)
    output.print(text, end="")
    for name, content in (
        (f"{plan.kind}.txt", text),
        (f"{plan.kind}.tex", as_latex(plan, results)),
        (f"{plan.kind}.csv", as_csv(plan, results, folder)),
        (f"{plan.kind}_means.csv", means_as_csv(plan, results)),
        ("index.html", as_page(plan, results, folder, published_costs(plan))),
    ):
        write_text(folder.path / name, content)
        output.print(f"written  {folder.path / name}")


def _exit_status(
    plan: Plan,
    results: Results,
    folder: ExperimentFolder,
    outcome: Outcome[PlannedRun],
    output: Console,
) -> int:
    """Return 0, or 130 after Ctrl-C.

    Raises:
        RunError: a run failed.
    """
    if outcome.stopped:
        finished = sum(bool(found) for found in results.values())
        output.print(
            f"stopped; {finished} of {len(plan.runs)} runs are finished. "
            "The same command continues from here."
        )
        return INTERRUPTED
    if outcome.failures:
        first, failure = next(iter(outcome.failures.items()))
        path = folder.run(first).path
        raise RunError(
            f"{len(outcome.failures)} of {len(plan.runs)} runs failed; the first error:\n{failure}",
            where=str(path.with_name(f"{path.name}.log")),
            fix="fix the cause; the same command then trains the missing runs",
        )
    return 0
