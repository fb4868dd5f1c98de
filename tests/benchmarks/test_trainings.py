"""Trainings of campaigns: the pipeline that is measured, its record, and the file of records."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml

from benchmarks.records import Record, read, save
from benchmarks.trainings import ALEXNET, VGG, Training
from registry import RunError
from tests.benchmarks.made import folder_in, tiny, train, training


def metrics_of(run: Training) -> list[str]:
    written = yaml.safe_load(run.measured_pipeline)
    return [metric.get("name", metric["use"]) for metric in written["metrics"]]


def test_lpips_is_measured_by_both_networks_or_by_neither(tmp_path: Path) -> None:
    file = tiny(tmp_path, metrics="[psnr, lpips]")
    both = training(file)
    assert metrics_of(both) == ["psnr", VGG, ALEXNET]
    assert [item.name for item in both.pipeline.items["metrics"]] == ["psnr", VGG]
    written = yaml.safe_load(both.measured_pipeline)
    assert [metric.get("network") for metric in written["metrics"]] == [None, "vgg", "alex"]
    unchanged = yaml.safe_load(both.pipeline.to_yaml())
    changed = {key for key in written if written[key] != unchanged.get(key)}
    assert changed == {"metrics", "exporters", "reports"} & changed
    assert metrics_of(training(file, without=(VGG,))) == ["psnr"]
    named = f"[lpips, {{use: lpips, name: {ALEXNET}, network: alex}}]"
    assert metrics_of(training(tiny(tmp_path, metrics=named))) == [VGG, ALEXNET]
    assert metrics_of(training(tiny(tmp_path, metrics="[psnr]"))) == ["psnr"]


@pytest.mark.proof
def test_trainings_record_scores_costs_and_circumstances_or_a_missing_score(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("STEREOGS_MODELS")
    run = training(tiny(tmp_path, metrics="[psnr, ssim]"))
    lacking = training(tiny(tmp_path, "lacking", metrics="[lpips]"))
    ((record,), (error,)) = train([run, lacking], tmp_path)
    assert error.startswith("stereogs: a score is missing")
    assert "set STEREOGS_MODELS" in error
    found = record.measured
    assert record.run is run
    assert set(record.scores) == {"psnr", "ssim"}
    assert len(found["views"]) == 2  # the test views, and no others
    assert found["gaussians"] == found["initial_points"] == 100
    assert (found["method"], found["iterations"], len(found["hash"])) == ("tiny", 4, 64)
    assert found["process_cpu_seconds"] > found["cpu_seconds"] > 0
    assert found["seconds"] > 0
    assert {"logged", "processor_model"} <= set(found)
    assert {"torch", "stereogs-plugins"} <= set(found["packages"])
    assert len(list((tmp_path / "out" / run.name / "renders").glob("*.png"))) == 2


def test_lines_are_sorted_and_a_record_of_another_pipeline_is_skipped(tmp_path: Path) -> None:
    file = folder_in(tmp_path).kept
    a, b = (training(tiny(tmp_path, name)) for name in "ab")
    for run, psnr in ((b, 1.0), (a, 2.0), (b, 3.0)):
        save(run, {"scores": {"psnr": psnr}}, file)
    lines = [json.loads(line) for line in file.read_text("utf-8").splitlines()]
    identity = {"method": "a", "seed": 0, "pipeline": "0123456789"}
    assert lines[0] == {"name": "a", **identity, "scores": {"psnr": 2.0}}
    assert [(line["name"], line["scores"]["psnr"]) for line in lines] == [("a", 2.0), ("b", 3.0)]
    (record,) = read([b, training(tiny(tmp_path, "c"))], file)
    assert record.measured == {"method": "b", "seed": 0, "scores": {"psnr": 3.0}}
    object.__setattr__(b, "digest", "another")
    assert read([b], file) == []
    file.write_text("[]", "utf-8")
    with pytest.raises(RunError, match="cannot be read"):
        read([a], file)


@pytest.mark.parametrize(
    ("model", "built_for", "expected"),
    [
        (None, None, "AMD EPYC"),
        ("family 26", None, "AMD EPYC (family 26)"),
        ("family 25", "skx", "AMD EPYC (family 25, kernels for skx)"),
    ],
)
def test_a_processor_is_named_as_far_as_it_is_known(
    model: str | None, built_for: str | None, expected: str, tmp_path: Path
) -> None:
    device = {"name": "pthread-AMD EPYC"} | ({"built_for": built_for} if built_for else {})
    measured = {"device": device, "processor_model": model}
    assert Record(training(tiny(tmp_path)), measured).processor == expected
