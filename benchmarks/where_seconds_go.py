"""Time of each stage of a training run, from the start of the process to the last file: `make profile`.

Trains `pipelines/weightfree_fast.yaml` on three photographs of llff_fern as the command line does, each time
in a new process and without the cache of prior answers: once with an empty cache of compiled kernels, then
`--repeats` times with a filled one. With `--write-docs` the table and picture in `docs/run_time.md` are
rewritten.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from statistics import median

from benchmarks import pages
from benchmarks.stage_clock import BORN
from benchmarks.trainings import DATA, PIPELINES
from stereogs.experiments.showing.score_table import markdown

ROOT = Path(__file__).parent.parent
TARGET = "profile"
PICTURE = pages.DOCS / "images" / "stages.png"

Taken = dict[str, list[float]]
"""Wall and CPU seconds by stage."""


def measure(compiled: Path, out: Path) -> Taken:
    """Run one training.

    Args:
        compiled: Folder of PoCL's cache of kernels.
        out: An empty folder.
    """
    record = out / "stages.json"
    environment = {
        **os.environ,
        "STEREOGS_CACHE": "",
        "POCL_CACHE_DIR": str(compiled),
        BORN: str(time.monotonic()),
    }
    command = [sys.executable, "-m", "benchmarks.stage_clock", str(record), "train"]
    command += [str(PIPELINES / "weightfree_fast.yaml"), "--out", str(out / "run")]
    subprocess.run(command, cwd=ROOT, env=environment, check=True, stdout=subprocess.DEVNULL)
    taken: Taken = json.loads(record.read_text())
    return taken


def medians(runs: Sequence[Taken]) -> Taken:
    """Return the medians of each stage."""
    return {name: [median(run[name][i] for run in runs) for i in range(2)] for name in runs[0]}


def table(first: Taken, warm: Taken) -> str:
    """Return the stages as a table, in the order in which they first start.

    Args:
        first: A run with an empty cache of compiled kernels.
        warm: Runs with a filled cache.
    """
    whole = sum(cpu for _, cpu in warm.values())
    rows = [
        [
            name,
            f"{wall:.2f}",
            f"{cpu:.2f}",
            f"{cpu / whole:.1%}",
            *(f"{s:.2f}" for s in first[name]),
        ]
        for name, (wall, cpu) in warm.items()
    ]
    sums = [sum(row[i] for row in taken.values()) for taken in (warm, first) for i in range(2)]
    wall, cpu, *first_run = (f"**{seconds:.2f}**" for seconds in sums)
    rows.append(["**total**", wall, cpu, "100%", *first_run])
    headings = ["stage", "wall s", "CPU s", "share of CPU", "first run, wall s", "CPU s"]
    return markdown(headings, rows)


def draw(warm: Taken, path: Path) -> None:
    """Draw a bar of CPU seconds for each stage; wall time would depend on other processes."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 0.32 * len(warm) + 0.9), dpi=110, layout="constrained")
    axes = figure.subplots()
    axes.barh([*warm], [cpu for _, cpu in warm.values()], height=0.7)
    axes.invert_yaxis()
    axes.set_xlabel("CPU seconds, all threads together")
    axes.grid(axis="x", alpha=0.25)
    figure.savefig(path)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=3, help="runs with compiled kernels")
    parser.add_argument(
        "--write-docs", action="store_true", help="rewrite the table, and the picture in docs"
    )
    arguments = parser.parse_args()
    if not os.environ.get(DATA):
        parser.error(f"{DATA} is not set: name the folder that holds llff_fern")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        runs = []
        for number in range(arguments.repeats + 1):
            (out := folder / str(number)).mkdir()
            runs.append(measure(folder / "compiled", out))
        first, warm = runs[0], medians(runs[1:])
    text = table(first, warm)
    print(text)
    if arguments.write_docs:
        pages.write_tables("profile", "Stages of weightfree_fast", TARGET, text)
        draw(warm, PICTURE)
    return 0


if __name__ == "__main__":
    sys.exit(main())
