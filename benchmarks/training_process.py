"""One training of `benchmarks.methods` or `benchmarks.results`; what it scored and what it took."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Collection
from pathlib import Path
from time import process_time
from typing import Any

from core_rasterizer.errors import ExplainedError
from registry import RunError
from registry.runs.evaluation import evaluate
from registry.runs.origin.provenance import circumstances
from registry.session import build_pipeline, train
from registry.system.files import write_json
from registry.system.memory import peak_memory_mb
from registry.training.threads import one_torch_thread

FAILED = "training_process: "
"""What stands before the error that ended a training."""


def measure(
    pipeline_file: Path, pictures: Path, device: str | None, without: Collection[str] = ()
) -> dict[str, Any]:
    """Train a pipeline and score its test views once, at the end.

    Args:
        without: names of metrics that are left out; a protocol asks for all of its own.

    Returns:
        Plain JSON values. Seconds are those of initialization and training, CPU seconds those of the
        same and of loading the scene, memory the most until then: scoring is in none of them.

    Raises:
        RunError: the run did not reach its end, or a score is missing.
        ExplainedError: whatever goes wrong.
    """
    pipeline = build_pipeline(pipeline_file)
    begin = process_time()
    run = train(pipeline, device=device)
    cpu_seconds, memory = process_time() - begin, peak_memory_mb()
    if not run.finished:
        raise RunError("the training was stopped", where=str(pipeline_file))
    pictures.mkdir(parents=True, exist_ok=True)
    metrics = [part for part in run.parts["metrics"] if part.item.name not in without]
    with one_torch_thread():
        scores = evaluate(run.model, run.scene, run.scene.test, metrics, pictures)
    missing = [*scores.unavailable.values(), *(error.what for error in scores.failures.values())]
    if missing:
        raise RunError(
            f"a score is missing: {missing[0]}",
            where=str(pipeline_file),
            fix="set STEREOGS_MODELS to the folder with the networks for LPIPS (docs/prior_models.md)",
        )
    around = circumstances(pipeline, run.model.device)
    # The moment is the end of the run; the command is this process's and says nothing of the pipeline.
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
        "peak_memory_mb": None if memory is None else round(memory),
        "hash": run.hash,
        **around,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("pipeline", type=Path)
    parser.add_argument("pictures", type=Path, help="the folder of the test views' pictures")
    parser.add_argument("answer", type=Path, help="the JSON file of what was measured")
    parser.add_argument("--device", help="part of a device's name")
    parser.add_argument("--without", nargs="*", default=[], help="metrics that are left out")
    asked = parser.parse_args()
    try:
        measured = measure(asked.pipeline, asked.pictures, asked.device, asked.without)
    except ExplainedError as error:
        sys.exit(f"{FAILED}{error}")
    write_json(asked.answer, measured)


if __name__ == "__main__":
    main()
