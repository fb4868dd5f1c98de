"""The verbs that train, resume, evaluate and render a run."""

from __future__ import annotations

import json
from pathlib import Path

import fsspec
import pytest
from torch import Tensor

from registry import Step
from stereogs.command_line.output import print_failures
from tests.host import SELECTION, main
from tests.registry.conftest import TOY_ENTRIES

Capture = pytest.CaptureFixture[str]


def test_train_eval_render(pipeline: Path, capsys: Capture) -> None:
    assert main(["train", "toy.yaml", "--set", "training.seed=3"]) == 0
    output = capsys.readouterr().out
    run = Path("runs/toy-tiny")
    results = json.loads((run / "results.json").read_text())
    assert results["seed"] == 3
    for text in ("test mean", "psnr", results["hash"], "runs/toy-tiny/exports/count.txt"):
        assert text in output
    (run / "results.json").unlink()
    assert main(["eval", str(run)]) == 0
    assert "test mean" in capsys.readouterr().out
    again = json.loads((run / "results.json").read_text())
    assert (again["hash"], again["test"]) == (results["hash"], results["test"])
    assert main(["render", str(run)]) == 0
    assert "1 test view" in capsys.readouterr().out
    assert main(["render", str(run), "--path", "--frames", "5"]) == 0
    assert "runs/toy-tiny/renders/path" in capsys.readouterr().out
    assert main(["train", "toy.yaml"]) == 0
    assert Path("runs/toy-tiny-2/results.json").is_file()


def test_a_report_is_written_later(pipeline: Path, capsys: Capture) -> None:
    assert main(["train", "toy.yaml"]) == 0
    run = Path("runs/toy-tiny")
    before = json.loads((run / "results.json").read_text())
    assert before["reports"] == []
    capsys.readouterr()
    assert main(["report", str(run)]) == 0
    assert "page  runs/toy-tiny/report.txt" in capsys.readouterr().out
    assert (run / "report.txt").is_file()
    assert "report.txt" in json.loads((run / "results.json").read_text())["reports"]
    (run / "results.json").unlink()
    assert main(["report", str(run)]) == 2
    assert "the run has not finished" in capsys.readouterr().err


def test_a_report_needs_no_plugin_that_only_trained(
    pipeline: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert main(["train", "toy.yaml"]) == 0
    monkeypatch.setenv(SELECTION, ",".join(name for name in TOY_ENTRIES if name != "toy_term"))
    assert main(["report", "runs/toy-tiny"]) == 0
    assert "page  runs/toy-tiny/report.txt" in capsys.readouterr().out


def test_what_failed_is_printed_with_its_remedy(capsys: Capture) -> None:
    failure = {"component": "exporters.sog", "what": "no program", "where": "", "fix": "install it"}
    assert print_failures([failure], "runs/x") == 1
    lines = capsys.readouterr().err.splitlines()
    assert lines[:2] == ["stereogs: exporters.sog: no program", "  fix    install it"]


def test_resume_of_a_finished_run(pipeline: Path, capsys: Capture) -> None:
    assert main(["train", "toy.yaml", "--out", "here"]) == 0
    assert main(["resume", "here"]) == 0
    assert "continuing after iteration 5 of 5" in capsys.readouterr().out
    provenance = json.loads(Path("here/provenance.json").read_text())
    assert provenance["plugins"]["scene.toy_scene"].startswith("toys 1.5, code ")


def test_interrupted_during_training(
    pipeline: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    import signal

    from tests.registry.toy_plugin import ToyTerm

    original = ToyTerm.loss

    def loss(self: ToyTerm, step: Step) -> Tensor:
        signal.raise_signal(signal.SIGINT)
        return original(self, step)

    with monkeypatch.context() as patch:
        patch.setattr(ToyTerm, "loss", loss)
        assert main(["train", "toy.yaml", "--out", "run"]) == 130
    assert "stereogs resume run" in capsys.readouterr().out
    assert main(["resume", "run"]) == 0
    assert "continuing after iteration 1 of 5" in capsys.readouterr().out


def test_an_iteration_that_failed_is_repeated(
    pipeline: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    from tests.registry.toy_plugin import ToyTerm

    def loss(self: ToyTerm, step: object) -> object:
        raise ZeroDivisionError("boom")

    with monkeypatch.context() as patch:
        patch.setattr(ToyTerm, "loss", loss)
        assert main(["train", "toy.yaml", "--out", "run"]) == 2
        told = capsys.readouterr().err
        assert "stereogs replay run/failures/iteration-0000001" in told
        assert main(["replay", "run/failures/iteration-0000001"]) == 2
        assert capsys.readouterr().err.splitlines()[0] == told.splitlines()[0]
    assert main(["replay", "run/failures/iteration-0000001"]) == 0
    monkeypatch.setenv("STEREOGS_CACHE", "cache")
    fsspec.filesystem("memory").put("run/", "/failed/run", recursive=True)
    assert main(["replay", "memory://failed/run/failures/iteration-0000001"]) == 0
    assert "succeeds now; it had failed with: the" in capsys.readouterr().out
    file = "memory://failed/run/failures/iteration-0000001/manifest.json"
    assert main(["replay", file]) == 0
    assert main(["replay", "memory://failed/run"]) == 2
    assert "not a failed iteration: it has no manifest.json" in capsys.readouterr().err
    assert main(["resume", "run"]) == 0
