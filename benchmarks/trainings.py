"""Trainings that campaigns plan, and the processes that measure them (`benchmarks.training_process`)."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar

import yaml

from registry import RunError
from registry.messages.suggestions import listing
from registry.pipeline.pipeline import Pipeline
from registry.pipeline.yaml_source import Node, to_yaml
from registry.runners import RunningTask, TrainingTask
from registry.toolkit.cache.entries import FOLDER_VARIABLE
from stereogs.experiments.running.local_processes import LocalProcesses, TrainingProcess

DATA, MODELS = "STEREOGS_DATA", "STEREOGS_MODELS"
PIPELINES = Path(__file__).parent.parent / "pipelines"
SEEDS = (0, 1, 2)
VGG, ALEXNET = "lpips", "lpips_alex"
THREADS = "POCL_MAX_PTHREAD_COUNT"

Points = Literal["own", "same"]
"""First points: those of the method, or the same for all methods."""
POINTS: tuple[Points, ...] = ("own", "same")


@dataclass(frozen=True)
class Case:
    """A data set with a number of training views.

    Args:
        data: Name of the data set and of its folder.
        views: Number of training photographs.
        protocol: Name of the protocol; empty if published protocols do not cover the scene.
        overrides: Overrides of all pipelines, as for `--set`: protocol and scene.
        baseline_overrides: Overrides of the baseline only.
    """

    data: str
    views: int
    protocol: str
    overrides: tuple[str, ...]
    baseline_overrides: tuple[str, ...] = ()


@dataclass(frozen=True)
class Method:
    """A pipeline that is measured, a row of a table.

    Args:
        title: Name in tables.
        file: File of the pipeline.
        baseline: If True, it takes `Case.baseline_overrides` and the others are compared with it.
        paper: Row of the StereoGS paper's tables, or None.
        points: First points that `make methods` trains it from.
    """

    title: str
    file: Path
    baseline: bool = False
    paper: str | None = None
    points: tuple[Points, ...] = POINTS


@dataclass(frozen=True, eq=False)
class Training:
    """One training of a campaign (`benchmarks.campaign`).

    Args:
        name: Name of its record and of its folder of outputs.
        identity: Its description in a record, plain JSON values.
        case, method, seed: Its place in the tables.
        pipeline: The pipeline, complete and checked.
        digest: Digest of the pipeline, independent of the location of the data.
        without: Metrics of its protocol to leave out.
    """

    name: str
    identity: dict[str, Any]
    case: Case
    method: Method
    seed: int
    pipeline: Pipeline
    digest: str
    without: tuple[str, ...] = ()

    @property
    def measured_pipeline(self) -> str:
        """The pipeline to train, as YAML: with the metrics to measure, without other outputs.

        LPIPS is measured by both networks or by neither; planned pipelines do not name AlexNet, so the
        digests of older records stay valid. The protocol, which fixes the metrics, is left out.
        """
        written = yaml.safe_load(self.pipeline.to_yaml())
        metrics = {metric.get("name", metric["use"]): metric for metric in written["metrics"]}
        for name in self.without:
            metrics.pop(name, None)
        if VGG in metrics:
            metrics.setdefault(ALEXNET, {"use": VGG, "name": ALEXNET, "network": "alex"})
        outputs = {"metrics": [*metrics.values()], "exporters": [], "reports": []}
        return to_yaml(written | outputs | {"protocol": None})


AnyTraining = TypeVar("AnyTraining", bound=Training)


def written_digest(tree: Node) -> str:
    """Return ten hexadecimal digits that depend on all that is written in a pipeline, except `fallbacks`.

    A campaign does not train with a fallback (`benchmarks.campaign`).
    """
    written = tree.as_written()
    for prior in written.get("priors") or []:
        if isinstance(prior, dict):
            prior.pop("fallbacks", None)
    return digest_of(json.dumps(written, sort_keys=True))


def digest_of(text: str) -> str:
    """Return the first ten hexadecimal digits of the SHA-256 hash of a text."""
    return hashlib.sha256(text.encode()).hexdigest()[:10]


def check_data(wanted: Iterable[str]) -> None:
    """Check that the data sets are present.

    Raises:
        RunError: STEREOGS_DATA is not set, or has no folder of that name for some.
    """
    names = list(dict.fromkeys(wanted))
    root = os.environ.get(DATA)
    if not root:
        raise RunError(
            f"{DATA} is not set", fix=f"set it to the folder that holds {listing(names)}"
        )
    missing = [name for name in names if not Path(root, name).is_dir()]
    if missing:
        raise RunError(
            f"{DATA} lacks {listing(missing)}", where=root, fix="put each into a folder of its name"
        )


class MeasuredProcesses(LocalProcesses):
    """Runs `benchmarks.training_process` in processes on this machine."""

    def start(self, task: TrainingTask) -> RunningTask:
        """Start a process for the task, with a share of the cores if several run at a time."""
        # Cached answers of an earlier run would make this one look fast.
        environment = {FOLDER_VARIABLE: ""}
        if self.places > 1:
            environment[THREADS] = str(max(1, (os.cpu_count() or 1) // self.places))
        module = ["benchmarks.training_process", str(task.folder)]
        return _Measured(task, module, self.lock, environment)


class _Measured(TrainingProcess):
    def stop(self) -> None:
        """Wait for its end: a measurement that is stopped and resumed has no time."""
