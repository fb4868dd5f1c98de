"""Trainings of one process, and what they scored and took; `benchmarks.trainings` starts it.

One training, or several that begin alike and share that beginning (`benchmarks.branches`).
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import Any

from benchmarks.both_networks import with_alexnet
from benchmarks.branches import Trained, train_branches
from benchmarks.scores import VGG
from core_rasterizer.errors import ExplainedError
from registry import RunError
from registry.runs.evaluation import evaluate
from registry.runs.origin import circumstances
from registry.session import build_pipeline
from registry.system.files import write_json
from registry.training.threads import one_torch_thread

PIPELINE, RENDERS, ANSWER = "pipeline.yaml", "renders", "answer.json"
"""In the folder of a training."""
FAILED = "training_process: "
"""What stands before the error that ended a training."""


def measure(
    folders: Sequence[Path], device: str | None, without: Collection[str] = ()
) -> Iterator[tuple[Path, dict[str, Any]]]:
    """Train the pipelines of some folders and score their test views once, at the end.

    Args:
        folders: each with a pipeline; pictures of the test views are written there.
        without: names of metrics that are left out; a protocol asks for all of its own. LPIPS is measured by
            both networks or by none.

    Yields:
        A folder and plain JSON values. Seconds are those of initialization and training, CPU seconds those of
        the same and of loading the scene, memory the most until then: scoring is in none of them.

    Raises:
        RunError: a run did not reach its end, or a score is missing.
        ExplainedError: whatever goes wrong.
    """
    pipelines = [build_pipeline(folder / PIPELINE) for folder in folders]
    if VGG not in without:
        pipelines = [with_alexnet(pipeline) for pipeline in pipelines]
    for folder, trained in zip(folders, train_branches(pipelines, device), strict=True):
        yield folder, _measured(trained, folder, without)


def _measured(trained: Trained, folder: Path, without: Collection[str]) -> dict[str, Any]:
    run, pictures = trained.run, folder / RENDERS
    pictures.mkdir(parents=True, exist_ok=True)
    metrics = [part for part in run.parts["metrics"] if part.item.name not in without]
    with one_torch_thread():
        scores = evaluate(run.model, run.scene, run.scene.test, metrics, pictures)
    missing = [*scores.unavailable.values(), *(error.what for error in scores.failures.values())]
    if missing:
        raise RunError(
            f"a score is missing: {missing[0]}",
            where=str(folder / PIPELINE),
            fix="set STEREOGS_MODELS to the folder with the networks for LPIPS (docs/prior_models.md)",
        )
    around = circumstances(run.pipeline, run.model.device)
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
        "cpu_seconds": round(trained.cpu_seconds, 1),
        "peak_memory_mb": trained.peak_memory_mb,
        "logged": trained.logged,
        "hash": run.hash,
        "processor_model": _processor_model(),
        **around,
    }


def _processor_model() -> str | None:
    """Family and model of the processor, None where the system does not tell them as Linux does."""
    file = Path("/proc/cpuinfo")
    if not file.is_file():
        return None
    found = dict(
        re.findall(r"^(cpu family|model)\s*: (\d+)$", file.read_text("utf-8"), re.MULTILINE)
    )
    return f"family {found['cpu family']}, model {found['model']}" if len(found) == 2 else None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "folders", type=Path, nargs="+", help=f"each with a {PIPELINE}; takes {ANSWER} and pictures"
    )
    parser.add_argument("--device", help="part of a device's name")
    parser.add_argument("--without", nargs="*", default=[], help="metrics that are left out")
    asked = parser.parse_args()
    try:
        for folder, measured in measure(asked.folders, asked.device, asked.without):
            write_json(folder / ANSWER, measured)
    except ExplainedError as error:
        sys.exit(f"{FAILED}{error}")


if __name__ == "__main__":
    main()
