"""Train and score one trial in its own process: `python -m ... FOLDER --started SECONDS`.

Seconds count from the start of the process, of the other program's for a program, to a state that can be
rendered. They include imports, loading and first points, and exclude scores, exports and copies of the state.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from core_rasterizer import ExplainedError, GaussianError, Gaussians
from registry import RunError
from registry.discovery import Plugins
from registry.pipeline.pipeline import Pipeline, parse_pipeline
from registry.runs.options import RunOptions
from registry.runs.run import Run
from registry.system.files import jsonable, write_json
from registry.system.memory import peak_memory_mb
from registry.training.trainer import Iteration

from ...session import train
from .scoring import about, score, scores_of
from .snapshots import Snapshots

TASK, RECORD, RUN = "task.json", "record.json", "run"
"""Names in the folder of a trial."""


def run_trial(folder: Path, started: float, device: str | None) -> dict[str, Any]:
    """Train, and return the record.

    Args:
        folder: contains the task, see `Trial.asked`.
        started: `time.time()` at the start of the process.

    Raises:
        RunError: the training stopped, used another configuration than was asked for, or a score is missing.
        ExplainedError: any other failure.
    """
    asked = json.loads((folder / TASK).read_text("utf-8"))
    pipeline = parse_pipeline(asked["pipeline"], Plugins(), source=str(folder / TASK))
    if asked["program"] is not None:
        from .other import run_program

        return {"asked": asked, **run_program(asked, pipeline, folder, device)}
    run, snapshots, costs = _followed(pipeline, asked["budgets"], folder, started, device)
    refuse_difference(pipeline, run)
    engine, final = run.engine_model.engine, scores_of(run.scores["test"], pipeline)
    rows = {}
    for budget in asked["budgets"]:
        if budget in snapshots.kept:
            kept = snapshots.kept[budget]
            scored = score(kept.state, run.framed, run.parts, engine)
            rows[budget] = {"seconds": kept.seconds, **scored}
        elif budget >= snapshots.seconds:
            rows[budget] = {"seconds": snapshots.seconds, **final}
    return {
        "asked": asked,
        **about(run.pipeline, run.parts, run.scene, engine),
        "budgets": {f"{budget:g}": row for budget, row in rows.items()},
        "end": {"seconds": snapshots.seconds, **final},
        "gaussians": run.engine_model.count,
        "hash": run.hash,
        **costs,
    }


def _followed(
    pipeline: Pipeline, budgets: Sequence[float], folder: Path, started: float, device: str | None
) -> tuple[Run, Snapshots[Gaussians], dict[str, Any]]:
    """Train; return the run, its states within the budgets, and CPU seconds and memory at its end."""
    begun, costs = list[tuple[Run, float]](), dict[str, Any]()
    snapshots = Snapshots(budgets, lambda: begun[0][0].engine_model.gaussians())

    def begin(run: Run) -> None:
        begun.append((run, time.time() - started))
        snapshots.complete(begun[0][1])

    def follow(_: Iteration) -> None:
        run, before = begun[0]
        snapshots.complete(before + run.seconds.training)  # without the time of copies
        costs.update(cpu_seconds=sum(os.times()[:4]), peak_memory_mb=peak_memory_mb())

    options = RunOptions(device=device, on_begin=begin, callback=follow)
    return train(pipeline, options, out=folder / RUN), snapshots, costs


def refuse_difference(pipeline: Pipeline, run: Run) -> None:
    """Refuse a run whose pipeline is not the one that was asked for.

    Raises:
        RunError: it was stopped, or another one was trained.
    """
    if not run.finished:
        raise RunError("the training was stopped", where=pipeline.name, fix="run it again")
    if not pipeline.wrote(run.pipeline_text):
        raise RunError(
            "another configuration was trained than was asked for",
            where=f"{run.folder_or_refuse().pipeline} and {TASK}",
            fix="has a plugin changed since the command started? Run it again",
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help=f"a folder with {TASK}; {RECORD} goes there")
    parser.add_argument("--started", type=float, required=True, help="time.time() at the start")
    parser.add_argument("--device", help="part of a device's name")
    given = parser.parse_args()
    try:
        record: Mapping[str, Any] = run_trial(given.folder, given.started, given.device)
    except (ExplainedError, GaussianError) as error:
        sys.exit(f"stereogs: {error}")
    write_json(given.folder / RECORD, jsonable(record))


if __name__ == "__main__":
    main()
