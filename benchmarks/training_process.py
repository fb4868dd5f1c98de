"""Train in one process and measure scores, time and memory; `benchmarks.trainings` starts it.

One training, or several that share their first iterations (`benchmarks.branches`).
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import Any

import yaml

from benchmarks.branches import Trained, train_branches
from benchmarks.cells import ALEXNET, VGG
from core_rasterizer.errors import ExplainedError
from registry import RunError
from registry.pipeline.pipeline import Pipeline
from registry.runs.evaluation import evaluate
from registry.runs.origin import circumstances
from registry.system.files import write_json
from registry.training.trainer import one_torch_thread
from stereogs.session import build_pipeline

PIPELINE, RENDERS, ANSWER = "pipeline.yaml", "renders", "answer.json"
"""Names in the folder of a training."""
FAILED = "training_process: "
"""Prefix of the error that ended a training."""


def measure(
    folders: Sequence[Path], device: str | None, without: Collection[str] = ()
) -> Iterator[tuple[Path, dict[str, Any]]]:
    """Train the pipelines of some folders and score their test views once, at the end.

    Args:
        folders: Folders with a pipeline each; pictures of the test views are written there.
        without: Names of metrics to leave out, although the protocol has them. LPIPS is measured by both
            networks or by neither.

    Yields:
        A folder and plain JSON values. Seconds cover initialization and training, CPU seconds also loading of
        the scene; memory is the peak until then. None of them includes scoring.

    Raises:
        RunError: a run did not finish, or a score is missing.
        ExplainedError: any other failure of a training.
    """
    pipelines = [build_pipeline(folder / PIPELINE) for folder in folders]
    if VGG not in without:
        pipelines = [with_alexnet(pipeline) for pipeline in pipelines]
    for folder, trained in zip(folders, train_branches(pipelines, device), strict=True):
        yield folder, _measured(trained, folder, without)


def with_alexnet(pipeline: Pipeline) -> Pipeline:
    """Return the pipeline with LPIPS by AlexNet added where it has LPIPS.

    Planned pipelines do not name it, so the digests of older records stay valid.
    """
    names = [item.name for item in pipeline.items["metrics"]]
    if VGG not in names or ALEXNET in names:
        return pipeline
    written = yaml.safe_load(pipeline.to_yaml())
    written["metrics"].append({"use": VGG, "name": ALEXNET, "network": "alex"})
    return build_pipeline(written)


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
    around = circumstances(run.pipeline, run.model.engine)
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
        "cpu_seconds": round(trained.cpu_seconds, 1),
        "peak_memory_mb": trained.peak_memory_mb,
        "logged": trained.logged,
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
    parser.add_argument(
        "folders",
        type=Path,
        nargs="+",
        help=f"folders with {PIPELINE}; {ANSWER} and pictures go there",
    )
    parser.add_argument("--device", help="part of a device's name")
    parser.add_argument("--without", nargs="*", default=[], help="metrics to leave out")
    arguments = parser.parse_args()
    try:
        for folder, measured in measure(arguments.folders, arguments.device, arguments.without):
            write_json(folder / ANSWER, measured)
    except ExplainedError as error:
        sys.exit(f"{FAILED}{error}")


if __name__ == "__main__":
    main()
