from __future__ import annotations

import json
import os
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from core_rasterizer import Device, open_device
from registry.cli import build_parser, main
from registry.inspection.self_test import Verdict

from ..conftest import TOY_ENTRIES, Install

PIPELINE = """\
name: toy
scene: toy_scene
initializer: toy_points
regularizers: [toy_term]
metrics: [psnr]
exporters: [toy_files]
training: {iterations: 5, sh_degree: 0}
"""

Capture = pytest.CaptureFixture[str]


@pytest.fixture
def pipeline(install: Install, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A pipeline file in an otherwise empty working folder; the toy plugin is installed."""
    install("toys", "1.5", TOY_ENTRIES)
    folder = tmp_path / "work"
    folder.mkdir()
    monkeypatch.chdir(folder)
    path = folder / "toy.yaml"
    path.write_text(PIPELINE)
    return path


def only_the_pipeline(pipeline: Path) -> bool:
    return list(pipeline.parent.iterdir()) == [pipeline]


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
    assert "1 test views" in capsys.readouterr().out
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
    assert "the run has not ended" in capsys.readouterr().err


def test_resume_of_a_finished_run(pipeline: Path, capsys: Capture) -> None:
    assert main(["train", "toy.yaml", "--out", "here"]) == 0
    assert main(["resume", "here"]) == 0
    assert "going on after iteration 5 of 5" in capsys.readouterr().out
    provenance = json.loads(Path("here/provenance.json").read_text())
    assert provenance["plugins"]["scene.toy_scene"] == "toys 1.5"


@pytest.mark.parametrize(
    ("arguments", "what", "where"),
    [
        (["train", "none.yaml"], "cannot be read", "none.yaml"),
        (["train"], "nothing to train", "command line"),
        (["resume", "none"], "not a run folder: there is no such folder", "none"),
        (["train", "toy.yaml", "--set", "scene.use=toy_scne"], "did you mean", "--set scene.use"),
        (["train", "toy.yaml", "--set", "metrics=[psmr]"], "did you mean 'psnr'", "--set metrics"),
        (["train", "toy.yaml", "--set", "training.seed=x"], "whole number", "--set training"),
        (["train", "toy.yaml", "--disable", "toy_trm"], "did you mean 'toy_term'", "--disable"),
        (["train", "toy.yaml", "--device", "no such"], "no OpenCL device", ""),
        (["train", "toy.yaml", "--set", "scene.mode=missing"], "no photographs", "folder/x"),
        (["train", "toy.yaml", "--set", "scene.mode=crash"], "boom", "toys 1.5"),
        (["train", "toy.yaml", "--set", "initializer.count=0"], "no points", "toy.yaml:3"),
        (["train", "toy.yaml", "--out", "toy.yaml"], "in the way", "toy.yaml"),
        (["train", "toy.yaml", "--out", "toy.yaml/x"], "nothing can be written", "toy.yaml/x"),
        (["eval", "."], "not a run folder: it has no pipeline.yaml", ""),
        (["render", "."], "not a run folder", ""),
    ],
)
def test_mistakes_end_in_one_message_and_no_folder(
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


def test_a_traceback_can_be_asked_for(
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


def test_interrupted_during_training(
    pipeline: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    import signal

    from tests.registry.toy_plugin import ToyTerm

    original = ToyTerm.loss

    def loss(self: ToyTerm, step: object) -> object:
        signal.raise_signal(signal.SIGINT)
        return original(self, step)  # type: ignore[arg-type]

    with monkeypatch.context() as patch:
        patch.setattr(ToyTerm, "loss", loss)
        assert main(["train", "toy.yaml", "--out", "run"]) == 130
    assert "stereogs resume run" in capsys.readouterr().out
    assert main(["resume", "run"]) == 0
    assert "going on after iteration 1 of 5" in capsys.readouterr().out


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
    assert "goes through; when it was kept, it failed: the" in capsys.readouterr().out
    assert main(["resume", "run"]) == 0


def test_plugins_are_listed(pipeline: Path, capsys: Capture) -> None:
    assert main(["plugins", "--check"]) == 0
    assert "11 components, no fault" in capsys.readouterr().out
    assert main(["plugins", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    term = next(p for p in listed["plugins"] if p["name"] == "toy_term")
    assert (term["section"], term["package"], term["version"]) == ("regularizers", "toys", "1.5")
    assert term["hook"] == "stereogs_register_regularizers"
    assert term["settings"]["properties"]["target"]["default"] == 0.5
    assert listed["faults"] == []


def test_the_list_fits_a_terminal(
    pipeline: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert main(["plugins"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 80
    assert "regularizers" in [line.strip() for line in lines]
    assert [line for line in lines if line.startswith("  toy_dropout  ")]


def test_a_module_may_say_in_a_sentence_what_its_component_is_for(
    install: Install, capsys: Capture
) -> None:
    code = """
    \"\"\"`slow_fade`: what is seldom seen
    fades.

    More.
    \"\"\"
    import registry
    class SlowFade(registry.Modifier[registry.Settings]):
        \"\"\"alpha <- alpha / 2.\"\"\"
        def opacity_scale(self, step): ...
    @registry.hookimpl
    def stereogs_register_modifiers(register):
        register("slow_fade", SlowFade)
    """
    install("fades", "1", {"slow_fade": "fades"}, fades=textwrap.dedent(code).strip())
    assert main(["plugins"]) == 0
    assert "slow_fade  what is seldom seen fades.\n" in capsys.readouterr().out
    assert main(["plugins", "slow_fade"]) == 0
    assert "\nwhat is seldom seen fades.\n\nalpha <- alpha / 2.\n" in capsys.readouterr().out


def test_one_component_is_shown(pipeline: Path, capsys: Capture) -> None:
    assert main(["plugins", "show", "toy_term"]) == 0
    output = capsys.readouterr().out
    for text in ("toy_term: regularizer (toys 1.5)", "  target = 0.5", "weight"):
        assert text in output
    assert main(["plugins", "toy_term"]) == 0
    assert capsys.readouterr().out == output
    assert main(["plugins", "toy_trem"]) == 2
    assert "did you mean 'toy_term'" in capsys.readouterr().err


def test_a_broken_plugin_is_told_and_fails_the_check(
    pipeline: Path, install: Install, capsys: Capture
) -> None:
    install("wreck", "0.2", {"wreck": "wreck_module"}, wreck_module="import nothing_like_this")
    assert main(["plugins"]) == 0
    assert "wreck (wreck 0.2) cannot be used" in capsys.readouterr().out
    assert main(["plugins", "--check"]) == 1
    assert main(["plugins", "--json", "--check"]) == 1


def completed(line: str, folder: Path) -> list[str]:
    """What the shell would offer after a line."""
    answer = folder / "answer"
    environment = {
        **{key: value for key, value in os.environ.items() if key != "STEREOGS_PLUGINS"},
        **{"_ARGCOMPLETE": "1", "_ARGCOMPLETE_IFS": "\n", "_ARGCOMPLETE_SHELL": "fish"},
        **{"_ARGCOMPLETE_STDOUT_FILENAME": str(answer), "_ARGCOMPLETE_SUPPRESS_SPACE": "1"},
        **{"COMP_LINE": line, "COMP_POINT": str(len(line)), "COMP_TYPE": "9"},
    }
    code = "from registry.cli import main; main()"
    subprocess.run([sys.executable, "-c", code], env=environment, cwd=folder, check=True)
    return [text.strip() for text in answer.read_text().splitlines()]


def test_a_shell_completes_verbs_pipelines_and_components(tmp_path: Path) -> None:
    (tmp_path / "weight.yaml").touch()
    assert completed("stereogs tra", tmp_path) == ["train"]
    offered = completed("stereogs train weight", tmp_path)
    assert {"weight.yaml", "weightfree", "weightfree_fast"} <= {*offered}
    assert completed("stereogs plugins show dropo", tmp_path) == ["dropout"]


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_is_printed(shell: str, capsys: Capture) -> None:
    assert main(["completion", shell]) == 0
    assert "stereogs" in capsys.readouterr().out


def test_doctor(capsys: Capture) -> None:
    assert main(["doctor"]) == 0
    output = capsys.readouterr().out
    assert output.count("<- chosen") == 1
    assert "self-test: passed" in output


@pytest.mark.parametrize(
    ("told", "better", "line"),
    [
        ("skx", None, "kernels are built for skx, which the driver was told"),
        (None, "skx", "STEREOGS_CORRECT_CPU_NAME=1 has faster kernels built, for skx"),
        (None, None, None),
    ],
)
def test_doctor_tells_of_a_driver_that_does_not_know_the_processor(
    told: str | None,
    better: str | None,
    line: str | None,
    capsys: Capture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Device, "built_for", told)
    monkeypatch.setattr(Device, "could_be_built_for", better)
    assert main(["doctor"]) == 0
    output = capsys.readouterr().out
    assert line in output if line else "kernels" not in output


def test_doctor_tells_of_a_device_that_fails_and_goes_on(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails_first(device: Device) -> Verdict:
        if device is devices[0]:
            raise RuntimeError("the driver is gone")
        return Verdict(0.0, 0.0)

    devices = [open_device(), open_device().as_variant("gpu")]
    monkeypatch.setattr("core_rasterizer.list_devices", lambda: devices)
    monkeypatch.setattr("registry.inspection.self_test.self_test", fails_first)
    assert main(["doctor"]) == 1
    output = capsys.readouterr().out
    assert "FAILED: RuntimeError: the driver is gone" in output
    assert "passed" in output


@pytest.mark.parametrize(
    "verb",
    [
        "train",
        "resume",
        "replay",
        "eval",
        "render",
        "report",
        "plugins",
        "doctor",
        "demo",
        "completion",
    ],
)
def test_every_verb_explains_itself_with_examples(verb: str, capsys: Capture) -> None:
    with pytest.raises(SystemExit) as caught:
        build_parser().parse_args([verb, "--help"])
    assert caught.value.code == 0
    text = capsys.readouterr().out
    assert f"stereogs {verb}" in text.split("examples:")[1]


def test_an_option_that_is_not_there_is_answered_with_the_nearest(capsys: Capture) -> None:
    assert main(["render", "run", "--pth"]) == 2
    error = capsys.readouterr().err
    assert "'--pth' is not understood; did you mean '--path'?" in error
    assert "where  stereogs render" in error


def test_an_unknown_format_is_refused_before_the_run_is_read(capsys: Capture) -> None:
    assert main(["export", "nowhere", "--format", "gtlf"]) == 2
    assert "no plugin offers the exporter 'gtlf'" in capsys.readouterr().err


def test_a_reader_who_leaves_early_is_no_fault() -> None:
    command = [sys.executable, "-m", "registry", "plugins", "--json"]
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
