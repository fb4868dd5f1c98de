"""Train and score one trial in its own process: `python -m ... FOLDER --started SECONDS`.

Seconds count from the start of the process, of the other program's for a program, to a state that can be
rendered. They include imports, loading and first points, and exclude scores, exports and copies of the state.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import registry.runs.training_run  # noqa: F401  # what `train` imports counts as start
from core_rasterizer import Engine, ExplainedError, GaussianError, Gaussians
from registry import RunError
from registry.calls.process_state import one_torch_thread
from registry.discovery import Plugins
from registry.pipeline.parts import Parts
from registry.pipeline.pipeline import Pipeline, parse_pipeline
from registry.runs.evaluation import Scores, evaluate
from registry.runs.options import RunOptions
from registry.runs.origin import circumstances, input_digests
from registry.runs.run import Run
from registry.system.cores import usable_cores
from registry.system.files import jsonable, write_json
from registry.system.memory import machine_memory, peak_memory_mb
from registry.training.initial_model import new_model
from registry.training.trainer import Iteration

from ...session import train
from .snapshots import Snapshots

TASK, RECORD, RUN = "task.json", "record.json", "run"
"""Names in the folder of a trial."""
_SOFTWARE = ("engine", "python", "source", "packages", "plugins", "plugin_sources")


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


def score(gaussians: Gaussians, scene: Any, parts: Parts, engine: Engine) -> dict[str, Any]:
    """Return the scores of the test views of a scene, in whose coordinates the Gaussians are."""
    model = new_model(gaussians, parts.pipeline.training, engine)
    with one_torch_thread():
        return scores_of(evaluate(model, scene, scene.test, parts["metrics"]), parts.pipeline)


def scores_of(scores: Scores, pipeline: Pipeline) -> dict[str, Any]:
    """Return means and views of scores.

    Raises:
        ExplainedError: a metric failed, or there are no test views.
    """
    if failed := next(iter(scores.failures.values()), None):
        raise failed
    if not scores.views:
        raise RunError("the scene has no test views", where=pipeline.name)
    return jsonable({"test": scores.mean, "views": scores.views, "unavailable": scores.unavailable})  # type: ignore[no-any-return]


def about(pipeline: Pipeline, parts: Parts, scene: Any, engine: Engine) -> dict[str, Any]:
    """Return protocol, data, machine and software of a result.

    Raises:
        RunError: the pipeline follows no protocol.
    """
    if pipeline.protocol is None:
        fix = "name one in the benchmark file"
        raise RunError("the result has no protocol", where=pipeline.name, fix=fix)
    around = circumstances(pipeline, engine)
    memory = machine_memory()
    digests = input_digests(scene, pipeline)
    views = {view.name for view in scene.test}
    return {
        "protocol": pipeline.protocol.record(),
        "inputs": {k: v for k, v in digests.items() if k.rpartition(" ")[2] in views},
        "machine": {
            "device": around["device"],
            "processor": _processor(),
            "cores": usable_cores(),
            "memory_gb": None if memory is None else round(memory / 1e9),
            "system": platform.system(),
        },
        "software": {name: around[name] for name in _SOFTWARE if name != "plugins"},
        "command": around["command"],
    }


def _processor() -> str:
    file = Path("/proc/cpuinfo")
    text = file.read_text("utf-8") if file.is_file() else ""
    found = re.search(r"^model name\s*: (.*)$", text, re.MULTILINE)
    return found[1] if found else platform.processor() or platform.machine()


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
