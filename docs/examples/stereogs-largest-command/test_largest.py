"""The verb prints the largest Gaussians of a run, largest first."""

from pathlib import Path

import pytest

import stereogs
from stereogs.cli import main


def test_it_lists_the_largest_first(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pipeline = {
        "name": "tiny",
        "scene": {"use": "procedural", "width": 32, "height": 24, "points": 300},
        "initializer": "sfm",
        "training": {"iterations": 2, "sh_degree": 0},
    }
    stereogs.train(pipeline, out=tmp_path / "run", progress=False)
    assert main(["largest", str(tmp_path / "run"), "--count", "3"]) == 0
    sizes = [float(line.split()[0]) for line in capsys.readouterr().out.splitlines()]
    assert len(sizes) == 3
    assert sizes == sorted(sizes, reverse=True)
