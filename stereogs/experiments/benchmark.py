"""Compare pipelines and other programs at equal time."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from registry import RunError

from ..command_line.arguments import add_device
from ..command_line.command import Command
from ..command_line.output import console

if TYPE_CHECKING:
    from rich.console import Console

    from .benchmarking.description import Benchmark as Described
    from .benchmarking.keeping import Records

_EPILOG = """\
examples:
  stereogs benchmark llff3.yaml

A benchmark file states everything that scores depend on:

  protocol: llff-3
  scenes: [llff_fern, llff_flower]     folders in STEREOGS_DATA, or paths with a slash
  entrants: [weightfree_quick, 3dgs_fast, opensplat]
  budgets: [5, 10, 30, 60, 300]        seconds
  seeds: 3                             0, 1, 2
  repeats: 2                           trainings with seed 0, for the noise floor

An entrant is a pipeline, or a file with the commands of another program; opensplat, gsplat and brush are
ready. A score at 10 seconds is that of the last complete state within 10 seconds since the start of the
process, without the time of scoring. Trials run one after another; keep the machine quiet. Finished trials
are not repeated, so the same command continues. Writes benchmark.txt, benchmark.tex and benchmark.csv.
"""
INTERRUPTED = 130


class Benchmark(Command):
    epilog = _EPILOG

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("file", type=Path, metavar="FILE", help="a benchmark file")
        parser.add_argument(
            "--out",
            type=Path,
            metavar="DIR",
            help="the folder to write (default: runs/benchmark-<file>)",
        )
        add_device(parser)

    def run(self, arguments: argparse.Namespace) -> int:
        """Run the missing trials, then write and print the tables."""
        from core_rasterizer import open_device
        from registry.discovery import Plugins

        from .benchmarking.description import read_benchmark
        from .benchmarking.keeping import TrialFolder, TrialProcesses, read_records
        from .running.folder import RUNS, ExperimentFolder
        from .running.pool import choose_runner, train_all

        plugins, output = Plugins(), console()
        benchmark = read_benchmark(arguments.file, plugins)
        path = arguments.out or Path("runs", f"benchmark-{benchmark.name}")
        folder, device = TrialFolder(path), open_device(arguments.device)
        part = choose_runner(None, None, plugins, device, TrialProcesses)
        with ExperimentFolder(path).locked() as lock:
            records = read_records(benchmark, folder)
            waiting = [trial for trial in benchmark.trials if trial not in records]
            part.component.lock = lock
            output.print(
                f"{len(benchmark.trials)} trials, {len(records)} finished; one at a time on "
                f"{device.name}; writing {path}"
            )
            outcome = train_all(waiting, folder, part, device=arguments.device, console=output)
            records = read_records(benchmark, folder)
        _write(benchmark, records, path, output)
        if outcome.stopped:
            output.print("stopped; the same command continues")
            return INTERRUPTED
        if outcome.failures:
            trial, failure = next(iter(outcome.failures.items()))
            raise RunError(
                f"{len(outcome.failures)} of {len(benchmark.trials)} trials failed; the first error:\n"
                f"{failure}",
                where=str(path / RUNS / f"{trial.name}.log"),
                fix="fix the cause; the same command then runs the missing trials",
            )
        return 0


def _write(benchmark: Described, records: Records, path: Path, output: Console) -> None:
    """Write the tables, and print them and the paths."""
    from io import StringIO

    from registry.messages.terminal import PlainConsole
    from registry.system.files import write_text

    from .benchmarking.tables import as_csv, tables

    head = f"{benchmark.protocol}: {', '.join(benchmark.scenes)}"
    made = tables(benchmark, records)
    text = StringIO()
    plain = PlainConsole(file=text, width=400, markup=False, highlight=False)
    plain.print(head)
    for table in made:
        plain.print(table.drawn())
    lines = "".join(f"{line.rstrip()}\n" for line in text.getvalue().splitlines())
    output.print(lines, end="")
    for suffix, content in (
        ("txt", lines),
        ("tex", "\n".join([f"% {head}", *(table.latex() for table in made)])),
        ("csv", as_csv(benchmark, records)),
    ):
        write_text(path / f"benchmark.{suffix}", content)
        output.print(f"written  {path / f'benchmark.{suffix}'}")
