"""The command: errors, Ctrl-C and help."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from stereogs.command_line.installed import verbs
from tests.host import main, parse_command

Capture = pytest.CaptureFixture[str]


def only_the_pipeline(pipeline: Path) -> bool:
    return list(pipeline.parent.iterdir()) == [pipeline]


@pytest.mark.parametrize(
    ("arguments", "what", "where"),
    [
        (["train", "none.yaml"], "cannot be read", "none.yaml"),
        (["train"], "arguments are required: PIPELINE", "stereogs train"),
        (["resume", "none"], "not a run folder: there is no such folder", "none"),
        (["train", "toy.yaml", "--set", "scene.use=toy_scne"], "did you mean", "--set scene.use"),
        (["train", "toy.yaml", "--set", "metrics=[psmr]"], "did you mean 'psnr'", "--set metrics"),
        (["train", "toy.yaml", "--set", "training.seed=x"], "whole number", "--set training"),
        (["train", "toy.yaml", "--disable", "toy_trm"], "did you mean 'toy_term'", "--disable"),
        (["train", "toy.yaml", "--device", "no such"], "no OpenCL device", ""),
        (["train", "toy.yaml", "--set", "scene.mode=missing"], "no photographs", "folder/x"),
        (["train", "toy.yaml", "--set", "scene.mode=crash"], "boom", "toys 1.5"),
        (["train", "toy.yaml", "--set", "initializer.count=0"], "no points", "toy.yaml:3"),
        (["train", "toy.yaml", "--out", "toy.yaml"], "the path is a file", "toy.yaml"),
        (["train", "toy.yaml", "--out", "toy.yaml/x"], "cannot be written", "toy.yaml/x"),
        (
            [
                *("train", "toy.yaml", "--scene", "\U0001f600"),
                *("--set", "scene.use=toy_scene", "--set", "scene.mode=missing"),
            ],
            "no photographs",
            "folder/x",
        ),
        (["train", ".", "--scene", "other"], "two scenes are given: . and other", ""),
        (["eval", "."], "not a run folder: it has no pipeline.yaml", ""),
        (["render", "."], "not a run folder", ""),
        (["render", "toy.yaml"], "it is a file", "`stereogs view FILE.ply` shows Gaussians"),
        (["compare", "toy.yaml"], "not a run folder: it is a file", "toy.yaml"),
        (["render", ".", "--frames", "9"], "only a path has frames", "--frames"),
        (["plugins", "toy_scene", "--json"], "are about all components", ""),
    ],
)
def test_an_error_prints_one_message_and_leaves_no_folder(
    pipeline: Path, capsys: Capture, arguments: list[str], what: str, where: str
) -> None:
    assert main(arguments) == 2
    captured = capsys.readouterr().err
    assert captured.startswith("stereogs: ")
    assert what in captured
    assert where in captured
    assert "fix " in captured
    assert "Traceback" not in captured
    assert only_the_pipeline(pipeline)


def test_an_environment_variable_shows_the_traceback(
    pipeline: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STEREOGS_TRACE", "1")
    assert main(["train", "toy.yaml", "--set", "scene.mode=crash"]) == 2
    captured = capsys.readouterr().err
    assert "Traceback" in captured
    assert "ZeroDivisionError: boom" in captured


def test_interrupted_before_training(
    pipeline: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    from tests.registry.toy_plugin import ToyScene

    def interrupt(self: ToyScene) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(ToyScene, "load", interrupt)
    assert main(["train", "toy.yaml"]) == 130
    assert "interrupted" in capsys.readouterr().err
    assert only_the_pipeline(pipeline)


@pytest.mark.parametrize("verb", list(verbs()))
def test_the_help_of_every_verb_has_examples(verb: str, capsys: Capture) -> None:
    with pytest.raises(SystemExit) as caught:
        parse_command([verb, "--help"])
    assert caught.value.code == 0
    text = capsys.readouterr().out
    assert f"stereogs {verb}" in text.split("examples:")[1]


def test_an_unknown_option_gets_a_suggestion(capsys: Capture) -> None:
    assert main(["render", "run", "--pth"]) == 2
    error = capsys.readouterr().err
    assert "'--pth' is not understood; did you mean '--path'?" in error
    assert "where  stereogs render" in error


def test_an_unknown_format_is_refused_before_the_run_is_read(capsys: Capture) -> None:
    assert main(["export", "nowhere", "--format", "gtlf"]) == 2
    assert "no plugin offers the exporter 'gtlf'" in capsys.readouterr().err


def test_a_closed_pipe_is_no_error() -> None:
    command = [sys.executable, "-m", "stereogs", "plugins", "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as started:
        assert started.stdout is not None
        assert started.stderr is not None
        started.stdout.read(1)
        started.stdout.close()
        assert started.stderr.read() == b""
        assert started.wait() == 0


def test_without_a_verb(capsys: Capture) -> None:
    assert main([]) == 0
    output = capsys.readouterr()
    assert "usage: stereogs" in output.out
    assert output.err == ""
