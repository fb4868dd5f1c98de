"""A training run from the first byte read to the last score written: `make profile`.

`pipelines/weightfree_fast.yaml` on three photographs of llff_fern, as the command line trains it, in a
process of its own each time, nothing from the cache of prior answers: once with an empty cache of compiled
kernels, then `--repeats` times with a filled one. With `--write-docs` the page and its picture are
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

from benchmarks.results_plan import DATA, PIPELINES
from benchmarks.stage_clock import BORN

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "where_the_seconds_go.md"
PICTURE = ROOT / "docs" / "images" / "where_the_seconds_go.png"
MARKS = ("<!-- measured: `make profile` rewrites from here -->\n", "<!-- measured: end -->\n")

Taken = dict[str, list[float]]
"""Wall and CPU seconds by stage."""


def measure(compiled: Path, out: Path) -> Taken:
    """One run.

    Args:
        compiled: the folder of PoCL's cache of kernels.
        out: an empty folder.
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
    """Stage by stage."""
    return {name: [median(run[name][i] for run in runs) for i in range(2)] for name in runs[0]}


def table(first: Taken, warm: Taken) -> str:
    """Markdown; stages in the order in which they first come, iterations together at the end."""
    lines = [
        "| stage | wall s | CPU s | share of CPU | wall s, kernels not yet built | CPU s |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    whole = sum(cpu for _, cpu in warm.values())
    for name, (wall, cpu) in warm.items():
        cold_wall, cold_cpu = first[name]
        row = f"| {name} | {wall:.2f} | {cpu:.2f} | {cpu / whole:.1%} "
        lines.append(f"{row}| {cold_wall:.2f} | {cold_cpu:.2f} |")
    sums = [sum(row[i] for row in taken.values()) for taken in (warm, first) for i in range(2)]
    wall, cpu, cold_wall, cold_cpu = sums
    lines.append(
        f"| **everything** | **{wall:.2f}** | **{cpu:.2f}** | 100% | {cold_wall:.2f} | {cold_cpu:.2f} |"
    )
    return "\n".join(lines) + "\n"


def draw(warm: Taken, path: Path) -> None:
    """A bar of CPU seconds for each stage; the wall clock would show the neighbours too."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 0.32 * len(warm) + 0.9), dpi=110, layout="constrained")
    axes = figure.subplots()
    axes.barh([*warm], [cpu for _, cpu in warm.values()], height=0.7)
    axes.invert_yaxis()
    axes.set_xlabel("CPU seconds, all threads together")
    axes.grid(axis="x", alpha=0.25)
    figure.savefig(path)


def write_page(text: str) -> None:
    """Put the table between the page's marks; what people wrote around it is kept."""
    page = PAGE.read_text("utf-8")
    before, _, rest = page.partition(MARKS[0])
    _, _, after = rest.partition(MARKS[1])
    PAGE.write_text(before + MARKS[0] + text + MARKS[1] + after, "utf-8")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=3, help="runs with kernels built")
    parser.add_argument("--write-docs", action="store_true", help="rewrite the page in docs/")
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
        write_page(text)
        draw(warm, PICTURE)
    return 0


if __name__ == "__main__":
    sys.exit(main())
