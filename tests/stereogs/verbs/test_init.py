"""`stereogs init`: the pipeline that it writes is complete, valid, and trains."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from tests.host import PIPELINE_POINTS, SELECTION, Plugins, faults, load_pipeline, main
from tests.stereogs_plugins.scenes.small_scenes import World, write_nerfstudio

Capture = pytest.CaptureFixture[str]


@pytest.fixture
def written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture) -> Path:
    monkeypatch.delenv(SELECTION, raising=False)
    monkeypatch.chdir(tmp_path)
    assert main(["init", "mine"]) == 0
    assert "stereogs train mine.yaml" in capsys.readouterr().out
    return tmp_path / "mine.yaml"


def test_it_has_every_section_and_names_every_component(written: Path) -> None:
    text = written.read_text("utf-8")
    sections = yaml.safe_load(text)
    assert [key for key in sections if key not in ("name", "training")] == [
        point.section for point in PIPELINE_POINTS
    ]
    for offer in Plugins().all():
        assert not offer.point.in_pipeline or f"{offer.name}" in text
    assert max(map(len, text.splitlines())) <= 110


def test_it_is_valid_and_explained_without_fault(written: Path) -> None:
    pipeline = load_pipeline(written, Plugins())
    assert pipeline.name == "mine"
    assert faults(pipeline) == []
    assert main(["explain", str(written)]) == 0


def test_it_trains_as_written_and_on_another_scene(written: Path, capsys: Capture) -> None:
    short = ["--set", "training.iterations=3", "--set", "training.seed=1"]
    assert main(["train", "mine.yaml", *short, "--out", "room", "--set", "scene.width=64"]) == 0
    write_nerfstudio(written.parent / "garden", World())
    capsys.readouterr()
    other = ["--scene", "garden", "--set", "initializer=random"]
    assert main(["train", "mine.yaml", *short, *other, "--out", "other"]) == 0
    assert "garden: 7 training views" in capsys.readouterr().out


def test_an_error_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(SELECTION, "typo")
    monkeypatch.chdir(tmp_path)
    assert main(["init", "mine"]) == 2
    assert list(tmp_path.iterdir()) == []


def test_no_file_is_replaced(written: Path, capsys: Capture) -> None:
    written.write_text("precious")
    assert main(["init", "mine.yaml"]) == 2
    assert written.read_text() == "precious"
    assert "choose another name" in capsys.readouterr().err
