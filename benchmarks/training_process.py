"""Train in one process and measure scores, time and memory; `benchmarks.campaign` starts it."""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path
from time import process_time
from typing import Any

from core_rasterizer.errors import ExplainedError
from registry import RunError
from registry.calls.process_state import one_torch_thread
from registry.runs.evaluation import evaluate
from registry.runs.origin import circumstances
from registry.system.files import write_json
from registry.system.memory import peak_memory_mb
from registry.training.trainer import Iteration
from stereogs.session import build_pipeline, train

PIPELINE, RENDERS, ANSWER = "pipeline.yaml", "renders", "answer.json"
"""Names in the folder of a training."""
SECONDS = "_seconds"
"""Suffix of the times that components log."""


def measure(folder: Path, device: str | None) -> dict[str, Any]:
    """Train the pipeline of a folder and score its test views once, at the end.

    Args:
        folder: Folder with a pipeline; pictures of the test views are written there.
        device: Part of the device's name, or None.

    Returns:
        Plain JSON values. Seconds cover initialization and training, `cpu_seconds` also loading of the scene;
        memory is the peak until then. None of them includes scoring; `process_cpu_seconds` includes all.
        `logged` are the values that components logged in the last iteration, times summed over all.

    Raises:
        RunError: the training was stopped, or a score is missing.
        ExplainedError: any other failure of the training.
    """
    pipeline, logged = build_pipeline(folder / PIPELINE), dict[str, float]()

    def follow(done: Iteration) -> None:
        for name, value in done.logged.items():
            before = logged.get(name, 0.0) if name.endswith(SECONDS) else 0.0
            logged[name] = before + value

    begin = process_time()
    run = train(pipeline, device=device, callback=follow)
    cpu_seconds, memory = process_time() - begin, peak_memory_mb()
    if not run.finished:
        raise RunError("the training was stopped", where=pipeline.name)
    (folder / RENDERS).mkdir(parents=True, exist_ok=True)
    with one_torch_thread():
        scores = evaluate(
            run.engine_model, run.framed, run.framed.test, run.parts["metrics"], folder / RENDERS
        )
    missing = [*scores.unavailable.values(), *(error.what for error in scores.failures.values())]
    if missing:
        raise RunError(
            f"a score is missing: {missing[0]}",
            where=str(folder / PIPELINE),
            fix="set STEREOGS_MODELS to a folder, then `stereogs models get lpips`",
        )
    around = circumstances(run.pipeline, run.engine_model.engine)
    # The time is the end of the run; the command is this process's, not the pipeline's.
    around["ended"], _ = around.pop("started"), around.pop("command")
    return {
        "scores": scores.mean,
        "views": scores.views,
        "size": [run.scene.test[0].camera.width, run.scene.test[0].camera.height],
        "initial_points": run.initialization["points"],
        "gaussians": run.model.count,
        "iterations": run.iteration,
        "seconds": round(run.seconds.initialization + run.seconds.training, 1),
        "cpu_seconds": round(cpu_seconds, 1),
        "process_cpu_seconds": round(process_time(), 1),
        "peak_memory_mb": None if memory is None else round(memory),
        "logged": logged,
        "hash": run.hash,
        "processor_model": _processor_model(),
        **around,
    }


def _processor_model() -> str | None:
    """Family and model of the processor; None where the system has no /proc/cpuinfo with both."""
    file = Path("/proc/cpuinfo")
    if not file.is_file():
        return None
    found = dict(
        re.findall(r"^(cpu family|model)\s*: (\d+)$", file.read_text("utf-8"), re.MULTILINE)
    )
    return f"family {found['cpu family']}, model {found['model']}" if len(found) == 2 else None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help=f"a folder with {PIPELINE}; {ANSWER} goes there")
    parser.add_argument("--device", help="part of a device's name")
    arguments = parser.parse_args()
    try:
        write_json(arguments.folder / ANSWER, measure(arguments.folder, arguments.device))
    except ExplainedError as error:
        sys.exit(f"stereogs: {error}")


if __name__ == "__main__":
    main()
