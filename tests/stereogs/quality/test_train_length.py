"""`stereogs train --seconds` and `--quality`, from the command line."""

from __future__ import annotations

from pathlib import Path

import pytest

from stereogs import results
from tests.host import main
from tests.registry.conftest import TOY_ENTRIES, Install

PIPELINE = """\
name: toy
scene: toy_scene
initializer: toy_points
metrics: [psnr]
training: {iterations: 60, sh_degree: 0}
"""
Capture = pytest.CaptureFixture[str]


@pytest.fixture
def pipeline(install: Install, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A pipeline file in a working folder of its own; the toy plugin is installed."""
    install("toys", "1.5", TOY_ENTRIES)
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "toy.yaml"
    path.write_text(PIPELINE)
    return path


def test_a_run_with_seconds_prints_its_estimate_and_how_to_repeat_it(
    pipeline: Path, capsys: Capture
) -> None:
    assert main(["train", "toy.yaml", "--seconds", "600", "--out", "first"]) == 0
    said = capsys.readouterr().out
    assert "trained: toy, 60 iterations" in said
    assert "expected" in said
    (line,) = (text for text in said.splitlines() if text.startswith("repeat"))
    command, _, took = line.removeprefix("repeat").strip().partition("; it took ")
    assert float(took.removesuffix(" s")) > 0
    assert main([*command.split()[1:], "--out", "second"]) == 0
    assert results("first")["hash"] == results("second")["hash"]
    assert "repeat" not in capsys.readouterr().out


def test_too_few_seconds_end_late_and_are_explained(pipeline: Path, capsys: Capture) -> None:
    assert main(["train", "toy.yaml", "--seconds", "0.001", "--out", "run"]) == 0
    said = capsys.readouterr().out
    assert "s instead of 0.001 s, because" in said
    assert "30 iterations took" in said
    assert results("run")["iterations"] == 30


@pytest.mark.parametrize(
    ("options", "what"),
    [
        (
            ["--seconds", "9", "--set", "training.iterations=5"],
            "--seconds conflicts with training.iterations",
        ),
        (["--quality", "best"], "--quality conflicts with the pipeline"),
    ],
)
def test_conflicting_options_are_rejected_and_write_nothing(
    pipeline: Path, capsys: Capture, options: list[str], what: str
) -> None:
    assert main(["train", "toy.yaml", *options]) == 2
    assert what in capsys.readouterr().err
    assert [*pipeline.parent.glob("runs")] == []


@pytest.mark.parametrize("options", [["--seconds", "-1"], ["--seconds", "5", "--quality", "fast"]])
def test_options_that_argparse_rejects(options: list[str], capsys: Capture) -> None:
    assert main(["train", "toy.yaml", *options]) == 2
    assert "--seconds" in capsys.readouterr().err
