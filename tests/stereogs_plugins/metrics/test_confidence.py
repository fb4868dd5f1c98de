"""Scores split by confidence, and what shows it, on a small run."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from plyfile import PlyData

import stereogs
from stereogs import Run
from stereogs_plugins.metrics.confidence import PSNRSeen, ViewAngle
from tests.host import SELECTION, confidence_section, main
from tests.stereogs_plugins.building import build

NAMES = ("psnr_seen", "psnr_unseen", "seen", "psnr_predicted", "view_angle")
PIPELINE: Mapping[str, Any] = {
    "name": "small",
    "scene": {"use": "procedural", "width": 32, "height": 24},
    "initializer": {"use": "random", "count": 200},
    "metrics": ["psnr", *NAMES],
    "exporters": [],
    "reports": ["html"],
    "training": {"iterations": 3},
}


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    monkeypatch.delenv(SELECTION, raising=False)
    return stereogs.train(stereogs.build_pipeline(PIPELINE), out=tmp_path / "run", progress=False)


def test_scores_are_split_beside_the_usual_mean(run: Run) -> None:
    results = stereogs.results(run.folder_or_refuse().path)
    assert results["failures"] == []
    assert list(results["test"]) == ["psnr", *NAMES]
    for row in results["views"]["test"].values():
        low, high = sorted([row["psnr_seen"] or row["psnr"], row["psnr_unseen"] or row["psnr"]])
        assert low - 1e-6 <= row["psnr"] <= high + 1e-6
        assert 0 <= row["seen"] <= 1
    assert list(results["train"]) == ["psnr"]


def test_the_model_has_the_same_bits_without_them(run: Run) -> None:
    plain = stereogs.build_pipeline({**PIPELINE, "metrics": ["psnr"], "reports": []})
    assert stereogs.train(plain, progress=False).hash == run.hash


def test_render_writes_what_the_report_shows(run: Run) -> None:
    folder = run.folder_or_refuse().path
    page = folder / "report.html"
    assert "What is guessed" not in page.read_text("utf-8")
    assert main(["render", str(folder), "--confidence", "coverage"]) == 0
    written = folder / "renders" / "confidence"
    numbers = json.loads((written / "confidence.json").read_text("utf-8"))
    assert numbers["estimator"] == "coverage"
    assert list(numbers["views"]) == [view.name for view in run.scene.test]
    for view in run.scene.test:
        assert (written / f"{view.name}.png").is_file()
        assert (written / f"{view.name}-scale.png").is_file()
    assert main(["report", str(folder)]) == 0
    assert "What is guessed" in page.read_text("utf-8")
    assert confidence_section(folder, numbers["iteration"] + 1) == "", "it shows another state"
    (written / "confidence.json").write_text('{"views": 3}', "utf-8")
    assert main(["report", str(folder)]) == 1


def test_a_run_without_test_views_shows_its_training_views(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv(SELECTION, raising=False)
    section = {"use": "procedural", "width": 32, "height": 24, "test_views": 0}
    pipeline = stereogs.build_pipeline({**PIPELINE, "metrics": [], "scene": section})
    folder = tmp_path / "trained"
    run = stereogs.train(pipeline, out=folder, progress=False)
    assert main(["render", str(folder), "--confidence", "coverage"]) == 0
    assert "training views" in capsys.readouterr().out
    numbers = folder / "renders" / "confidence" / "confidence.json"
    views = json.loads(numbers.read_text("utf-8"))["views"]
    assert list(views) == [view.name for view in run.scene.train]
    numbers.write_text('{"estimator": "coverage", "views": {}}', "utf-8")
    assert confidence_section(folder, run.iteration) == ""


def test_export_leaves_out_guesses_and_writes_the_values(run: Run, tmp_path: Path) -> None:
    every = stereogs.export(run, "ply", tmp_path / "all", min_confidence=0.0)[0]
    values = PlyData.read(every)["vertex"]["confidence"]
    assert len(values) == run.model.count
    assert 0 <= values.min() < values.max() <= 1
    middle = float(sorted(values)[len(values) // 2])
    some = stereogs.export(run, "ply", tmp_path / "some", min_confidence=middle)[0]
    kept = PlyData.read(some)["vertex"]["confidence"]
    assert kept.tolist() == values[values >= middle].tolist()
    with pytest.raises(stereogs.ExplainedError, match="all Gaussians would be left out"):
        stereogs.export(run, "ply", tmp_path / "none", min_confidence=1.0)
    (glb,) = stereogs.export(run, "gltf", tmp_path / "gltf", min_confidence=0.0)
    assert b'"_CONFIDENCE"' in glb.read_bytes()


def test_during_training_there_is_no_confidence(run: Run) -> None:
    view = run.scene.test[0]
    rendering = run.rendering(view.camera)
    answer = build(PSNRSeen).measure_view(rendering, view, run.scene)
    assert "after training" in getattr(answer, "reason", "")
    assert build(ViewAngle).measure_view(rendering, view, run.scene) > 0
