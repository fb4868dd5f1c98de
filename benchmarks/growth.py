"""CPU time by stage, and memory, against the number of views: `make bench-growth`.

Trains `weightfree_fast` for 30 iterations on the procedural room (96x72) as the command line does, each
number of views in a new process without the cache of prior answers. What is measured is recorded at once;
`--views` measures some numbers again. With `--write-docs` the table and the picture in
`docs/many_photographs.md` are rewritten.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks import pages
from benchmarks.records import RECORDS
from benchmarks.stage_clock import BORN
from registry.system.files import write_json
from stereogs.experiments.showing.score_table import markdown

ROOT = Path(__file__).parent.parent
TARGET, RECORD = "bench-growth", RECORDS / "growth.json"
PICTURE = pages.DOCS / "images" / "growth.png"
VIEWS = (3, 12, 24, 50, 100, 200, 300)
BETWEEN = (50, 300)
"""Numbers of views between which the exponent is taken."""
STAGES = {
    "photographs": "ray casting",
    "depth prior": "depth",
    "points": "points",
    "run folder and checkpoints": "run folder",
    "results and export": "results, report",
    "evaluation": "results, report",
}
"""Column for each stage of `benchmarks.stage_clock`; the other stages are only in the sum."""

TITLES = {"cpu": "CPU-s", "memory_mb": "peak MB", "folder_mb": "run folder MB"}
"""Of columns whose key is not their title."""


def measure(views: int) -> dict[str, Any]:
    """Return CPU seconds by column, `cpu`, `memory_mb` and `folder_mb` (10^6 bytes) of a training."""
    with tempfile.TemporaryDirectory() as name:
        record, run = Path(name) / "stages.json", Path(name) / "run"
        scene = f"scene={{use: procedural, train_views: {views}, width: 96, height: 72}}"
        command = [sys.executable, "-m", "benchmarks.stage_clock", str(record)]
        command += ["train", "weightfree_fast", "--set", scene, "--out", str(run)]
        command += ["--set", "training.iterations=30"]
        environment = {**os.environ, "STEREOGS_CACHE": "", BORN: str(time.monotonic())}
        subprocess.run(command, cwd=ROOT, env=environment, check=True, stdout=subprocess.DEVNULL)
        taken = {stage: cpu for stage, (_, cpu) in json.loads(record.read_text()).items()}
        results = json.loads((run / "results.json").read_text())
        size = sum(file.stat().st_size for file in run.rglob("*") if file.is_file())
    columns = dict.fromkeys(STAGES.values(), 0.0)
    for stage, column in STAGES.items():
        columns[column] += taken.get(stage, 0.0)
    memory = results["peak_memory_mb"]
    return {**columns, "cpu": sum(taken.values()), "memory_mb": memory, "folder_mb": size / 1e6}


def exponent(record: Mapping[str, Mapping[str, float]], column: str) -> float:
    """Return the exponent of growth with the number of views."""
    few, many = BETWEEN
    ratio = record[str(many)][column] / record[str(few)][column]
    return math.log(ratio) / math.log(many / few)


def table(record: Mapping[str, Mapping[str, float]]) -> str:
    """Return the numbers as a table with the exponents in the last row."""
    columns = list(dict.fromkeys(["cpu", *STAGES.values(), "memory_mb", "folder_mb"]))
    rows = [
        [views, *(f"{row[c]:.0f}" if row[c] >= 100 else f"{row[c]:.1f}" for c in columns)]
        for views, row in sorted(record.items(), key=lambda item: int(item[0]))
    ]
    if all(str(views) in record for views in BETWEEN):
        exponents = (f"{exponent(record, column):.2f}" for column in columns)
        rows.append(["exponent, {} to {}".format(*BETWEEN), *exponents])
    return markdown(["views", *(TITLES.get(column, column) for column in columns)], rows)


def draw(record: Mapping[str, Mapping[str, float]], path: Path) -> None:
    """Draw CPU seconds and memory against the number of views, with a line of exponent 1."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 3.4), dpi=110, layout="constrained")
    views = sorted(map(int, record))
    shown = {"CPU seconds": ("cpu", "depth", "points"), "MB": ("memory_mb", "folder_mb")}
    for axes, (unit, columns) in zip(figure.subplots(1, 2), shown.items(), strict=True):
        for column in columns:
            numbers = [record[str(v)][column] for v in views]
            axes.loglog(views, numbers, "o-", label=TITLES.get(column, column))
        axes.set_ylabel(unit)
        last = record[str(views[-1])][columns[0]]
        axes.loglog(views, [last * v / views[-1] for v in views], ":", label="linear")
        axes.set_xlabel("training views")
        axes.grid(alpha=0.25)
        axes.legend()
    figure.savefig(path)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--views", type=int, nargs="*", default=VIEWS, help="numbers of views")
    parser.add_argument("--write-docs", action="store_true", help="rewrite table and picture")
    options = parser.parse_args(arguments)
    record = json.loads(RECORD.read_text()) if RECORD.is_file() else {}
    for views in options.views:
        record[str(views)] = measure(views)
        write_json(RECORD, record)
    print(table(record))
    if options.write_docs:
        pages.write_tables(
            "growth", "CPU seconds and memory with 3 to 300 views", TARGET, table(record)
        )
        draw(record, PICTURE)
    return 0


if __name__ == "__main__":
    sys.exit(main())
