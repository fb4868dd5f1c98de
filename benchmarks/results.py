"""Both pipelines on every data set: `python -m benchmarks.results`, which `make results` runs.

Each run is a `stereogs train` of its own, one at a time, in `benchmarks/out/results/runs`. What is
finished with the same pipeline is not trained again: the same command goes on where it was stopped.
A change of the code is not seen; remove the folder to measure anew. With `--write-docs` the page in
`docs/` is rewritten once everything is there, except what people wrote on it. A picture of test views
lies beside the runs.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from benchmarks.results_page import (
    PAGE,
    Record,
    draw_first_views,
    page_text,
    read_records,
    write_page,
)
from benchmarks.results_plan import CASES, METHODS, Measurement, check_data, make_measurements
from core_rasterizer import open_device
from core_rasterizer.errors import ExplainedError
from registry import RunError
from registry.ablation.running.choosing import choose_runner
from registry.ablation.running.folder import AblationFolder
from registry.ablation.running.runner import train_all
from registry.cache import FOLDER_VARIABLE
from registry.plugins.discovery import Plugins

OUT = Path(__file__).parent / "out" / "results"
DOCS = Path(__file__).parent.parent / "docs"
PICTURE = "results.jpg"
INTERRUPTED = 130


def measure(
    measurements: Sequence[Measurement],
    folder: AblationFolder,
    device: str | None,
    console: Console,
) -> list[Record] | None:
    """Train what is missing and read everything; None if the user stopped it.

    Raises:
        RunError: some of the runs failed; says what the first one said.
    """
    os.environ[FOLDER_VARIABLE] = ""  # answers from an earlier run would make this one look fast
    with folder.locked() as lock:
        waiting = [m.run for m in measurements if not folder.results(m.run)]
        console.print(f"{len(measurements)} runs, {len(waiting)} to train; writing {folder.path}")
        runner = choose_runner(None, 1, Plugins(()), open_device(device))
        runner.component.lock = lock
        outcome = train_all(waiting, folder, runner, device=device, console=console)
    if outcome.stopped:
        return None
    if outcome.failures:
        run, said = next(iter(outcome.failures.items()))
        raise RunError(
            f"{len(outcome.failures)} of {len(waiting)} runs failed; the first one said:\n{said}",
            where=run.name,
            fix="mend the cause; the same command then trains what is missing",
        )
    return read_records(measurements, folder)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", help="part of a device's name")
    parser.add_argument("--iterations", type=int, help="a trial: train every run only so long")
    parser.add_argument(
        "--out", type=Path, default=OUT, help="where runs lie (default: %(default)s)"
    )
    parser.add_argument("--write-docs", action="store_true", help="rewrite the page in docs/")
    arguments = parser.parse_args()
    if arguments.write_docs and arguments.iterations is not None:
        parser.error("a trial is no result: leave out --iterations or --write-docs")
    console = Console(markup=False, highlight=False, soft_wrap=True)
    try:
        check_data(case.data for case in CASES)
        measurements = make_measurements(CASES, METHODS, Plugins(), arguments.iterations)
        folder = AblationFolder(arguments.out)
        records = measure(measurements, folder, arguments.device, console)
        if records is None:
            console.print("stopped; the same command goes on from here")
            return INTERRUPTED
        console.print(page_text(records))
        page = (DOCS if arguments.write_docs else arguments.out) / PAGE
        write_page(records, page)
        draw_first_views(records, arguments.out / PICTURE)
        console.print(f"written to {page} and {arguments.out / PICTURE}")
    except ExplainedError as error:
        sys.exit(f"results: {error}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
