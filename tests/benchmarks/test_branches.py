"""Trainings that begin alike: a branch ends in the bits of the whole run."""

from __future__ import annotations

import io
import json
from pathlib import Path

import pytest
from rich.console import Console

from benchmarks import training_records, trainings
from benchmarks.branches import shared_iterations, train_branches
from benchmarks.parts_plan import PartsRun, Row
from benchmarks.results_plan import Case
from benchmarks.training_process import ANSWER, RENDERS
from registry import RunError
from stereogs import Pipeline, build_pipeline, train

ROOM = Case("room", 3, "", ())
TEXT = """\
name: small
scene: {use: procedural, width: 64, height: 48, test_views: 1, points: 300}
initializer: sfm
priors: [sgm]
modifiers: [{use: dropout, rate: 0.2}]
regularizers: [{use: stereo_depth, start: 8, weight: 0.5}]
densification: {use: gradient_threshold, start: 4, every: 3}
opacity: {use: gradient_aware_decay, start: 3}
metrics: [psnr, ssim]
training: {iterations: 14, sh_degree: 1, sh_every: 5}
"""
OFF = "regularizers.stereo_depth.enabled=false"


def pipelines() -> list[Pipeline]:
    """Without the term, with it, with other settings and a later start, with another prior."""
    other = ["regularizers.stereo_depth.normalize=zref", "regularizers.stereo_depth.start=10"]
    prior = ["priors.sgm.radius=1"]
    return [build_pipeline(TEXT, changes) for changes in ([OFF], [], other, prior)]


def test_a_branch_ends_in_the_bits_of_the_whole_run() -> None:
    made = pipelines()
    assert shared_iterations(made) == 7
    whole = [train(pipeline, progress=False).hash for pipeline in made]
    found = list(train_branches(made, None))
    assert [one.run.hash for one in found] == whole
    assert len(set(whole[:3])) == 3
    again = list(train_branches(made[1:], None))  # the order does not matter
    assert [one.run.hash for one in again] == whole[1:]


def test_a_branch_logs_the_values_of_the_whole_run() -> None:
    without, with_it, *_ = train_branches(pipelines(), None)
    (alone,) = train_branches([build_pipeline(TEXT)], None)
    inferences = "stereo_depth_inferences"
    assert inferences not in without.logged
    assert with_it.logged[inferences] == alone.logged[inferences] > 0
    assert with_it.logged["stereo_depth_seconds"] > 0
    assert with_it.run.finished
    assert with_it.run.seconds.training > 0
    assert with_it.run.initialization["points"] == alone.run.initialization["points"]


@pytest.mark.parametrize(
    "change",
    ["modifiers.dropout.rate=0.3", "training.seed=1", "regularizers.stereo_depth.start=1"],
)
def test_pipelines_without_shared_iterations_are_rejected(change: str) -> None:
    with pytest.raises(RunError, match="do not share their first iterations"):
        shared_iterations([build_pipeline(TEXT), build_pipeline(TEXT, [change]), *pipelines()[:1]])


def test_a_group_records_each_training_when_it_ends(tmp_path: Path) -> None:
    runs = [
        PartsRun((Row("a table", (0, number), "a row"),), ROOM, 0, pipeline, str(number), "", None)
        for number, pipeline in enumerate(pipelines()[:2])
    ]
    failures = trainings.train(
        [runs],
        jobs=1,
        seconds=None,
        device=None,
        out=tmp_path / "out",
        kept=tmp_path / "records.jsonl",
        console=Console(file=io.StringIO()),
    )
    assert failures == {}
    records = training_records.read(runs, tmp_path / "records.jsonl")
    assert [record.run for record in records] == runs
    first, second = (record.measured for record in records)
    assert first["hash"] != second["hash"]
    assert second["cpu_seconds"] > 0
    assert second["peak_memory_mb"] is None  # the process has held another training too
    for run in runs:
        folder = tmp_path / "out" / run.name
        assert json.loads((folder / ANSWER).read_text("utf-8"))["iterations"] == 14
        assert len(list((folder / RENDERS).glob("*.png"))) == 1
