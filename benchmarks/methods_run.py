"""One training of `benchmarks.methods`, in a process of its own; what it scored and what it took.

python -m benchmarks.methods_run PIPELINE.yaml PICTURES ANSWER.json [DEVICE]
"""

from __future__ import annotations

import sys
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

FAILED = "methods_run: "
"""What stands before the error that ended a training."""


def measure(pipeline_file: Path, pictures: Path, device: str | None) -> dict[str, Any]:
    """Train a pipeline and score its test views once, at the end.

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
    with one_torch_thread():
        scores = evaluate(run.model, run.scene, run.scene.test, run.parts["metrics"], pictures)
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
    pipeline, pictures, answer, *device = sys.argv[1:]
    try:
        measured = measure(Path(pipeline), Path(pictures), device[0] if device else None)
    except ExplainedError as error:
        sys.exit(f"{FAILED}{error}")
    write_json(Path(answer), measured)


if __name__ == "__main__":
    main()
