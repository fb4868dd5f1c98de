from __future__ import annotations

import sys
from pathlib import Path

import pytest

from tests.host import main


def test_a_missing_package_is_reported_before_loading(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    assert main(["view", str(tmp_path / "nowhere")]) == 2
    assert "pip install 'stereogs-plugins[viewer]'" in capsys.readouterr().err


def test_an_invalid_run_or_ply_is_rejected(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("viser")
    assert main(["view", str(tmp_path)]) == 2
    assert "this is not a run folder" in capsys.readouterr().err
    (tmp_path / "points.ply").write_text("ply\nformat ascii 1.0\nend_header\n", "utf-8")
    assert main(["view", str(tmp_path / "points.ply")]) == 2
    assert "no 'vertex' element" in capsys.readouterr().err
