"""Every tool is a plugin: without its entry point the rest of the command line works."""

from __future__ import annotations

import importlib.metadata
import subprocess
import sys
from collections.abc import Callable
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path

import pytest

from core_rasterizer import ExplainedError
from stereogs.cli import main, parse
from stereogs.command_line import installed as commands
from stereogs.command_line.installed import COMMANDS, TRAIN_OPTIONS, verbs

TOOLS = [(COMMANDS, e.name) for e in importlib.metadata.entry_points(group=COMMANDS)] + [
    (TRAIN_OPTIONS, e.name) for e in importlib.metadata.entry_points(group=TRAIN_OPTIONS)
]
HOST = ("train", "resume")
EXAMPLES = {
    "train": ["train", "3dgs"],
    "resume": ["resume", "runs/x"],
    "eval": ["eval", "runs/x"],
    "explain": ["explain", "3dgs"],
    "init": ["init", "mine"],
    "ablate": ["ablate", "ablations/parts"],
    "bench": ["bench", "matrix.yaml"],
    "check": ["check", "folder"],
    "compare": ["compare", "runs/x", "runs/y"],
    "completion": ["completion", "bash"],
    "doctor": ["doctor"],
    "export": ["export", "runs/x", "--format", "ply"],
    "next": ["next", "runs/x"],
    "new-plugin": ["new-plugin", "solid", "--kind", "regularizer"],
    "priors": ["priors", "check", "model.onnx"],
    "render": ["render", "runs/x"],
    "replay": ["replay", "runs/x/failures/y"],
    "report": ["report", "runs/x"],
    "schema": ["schema"],
    "view": ["view", "runs/x"],
}

Answer = Callable[..., EntryPoints]


def without(group: str, name: str) -> Answer:
    """`entry_points` as if one entry were not installed."""

    def answer(**query: str) -> EntryPoints:
        found = importlib.metadata.entry_points(**query)
        return EntryPoints(e for e in found if (e.group, e.name) != (group, name))

    return answer


@pytest.mark.parametrize(("group", "name"), TOOLS, ids=lambda part: part)
def test_without_a_tool_the_rest_works(
    group: str, name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(commands, "entry_points", without(group, name))
    left = list(verbs())
    assert set(HOST) <= set(left)
    for verb in left:
        parsed = parse(EXAMPLES.get(verb, [verb]))
        assert callable(parsed.command.run)
    if group == COMMANDS:
        assert name not in left
        assert main([name]) == 2
        assert f"unknown verb {name!r}" in capsys.readouterr().err


def test_without_its_tool_an_option_is_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(commands, "entry_points", without(TRAIN_OPTIONS, "quality"))
    with pytest.raises(ExplainedError, match="'--seconds' is not understood"):
        parse(["train", "3dgs", "--seconds", "10"])


def test_without_quality_a_folder_needs_a_pipeline(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path_factory: pytest.TempPathFactory,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(commands, "entry_points", without(TRAIN_OPTIONS, "quality"))
    assert main(["train", str(tmp_path_factory.mktemp("pictures"))]) == 2
    error = capsys.readouterr().err
    assert "format is not known" in error or "no installed plugin chooses a pipeline" in error


def test_help_lists_every_verb_and_imports_no_tool() -> None:
    code = (
        "import sys\nfrom stereogs.cli import main\n"
        "try:\n    main(['--help'])\nexcept SystemExit:\n    pass\n"
        "print([m for m in sys.modules if m.startswith('stereogs_plugins') or m == 'torch'])"
    )
    output = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout
    assert output.splitlines()[-1] == "[]"
    for name, verb in verbs().items():
        assert f"    {name}" in output
        assert verb.summary


MODULE = '''"""Count the Gaussians of a run."""

import registry


class Count(registry.Command):
    """The verb `count`."""

    def add_arguments(self, parser):
        parser.add_argument("number", type=int)

    def run(self, arguments):
        print(arguments.number + 1)
        return 0


@registry.hookimpl
def stereogs_register_commands(register):
    register("{name}", {cls})
'''


def only(name: str, module: str) -> Answer:
    def answer(**query: str) -> EntryPoints:
        group = query.get("group")
        return EntryPoints([EntryPoint(name, module, COMMANDS)] if group == COMMANDS else [])

    return answer


def write(folder: Path, source: str, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    (folder / f"{name}.py").write_text(source)
    monkeypatch.syspath_prepend(folder)
    sys.modules.pop(name, None)


def test_another_package_adds_a_verb(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    source = MODULE.replace("{name}", "count").replace("{cls}", "Count")
    write(tmp_path, source, monkeypatch, "acme_count")
    monkeypatch.setattr(commands, "entry_points", only("count", "acme_count"))
    assert main(["count", "41"]) == 0
    assert capsys.readouterr().out == "42\n"
    with pytest.raises(SystemExit):
        main(["--help"])
    assert "count     count the Gaussians of a run" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("source", "what"),
    [
        ("import nothing_of_this_name", "cannot be imported: ModuleNotFoundError"),
        (
            MODULE.replace("{name}", "cont").replace("{cls}", "Count"),
            "registers cont, not 'broken'",
        ),
        (MODULE.replace("{name}", "broken").replace("{cls}", "int"), "not a subclass of registry"),
        ('"""Do nothing."""\n', "registers nothing, not 'broken'"),
    ],
)
def test_a_broken_verb_is_named(
    source: str,
    what: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    write(tmp_path, source, monkeypatch, "acme_broken")
    monkeypatch.setattr(commands, "entry_points", only("broken", "acme_broken"))
    assert main(["broken", "1"]) == 2
    error = capsys.readouterr().err
    assert what in error
    assert "acme_broken" in error
    with pytest.raises(SystemExit):  # the others still work
        main(["train", "--help"])


def test_a_verb_that_fails_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    source = MODULE.replace("{name}", "count").replace("{cls}", "Count").replace("+ 1", "/ 0")
    write(tmp_path, source, monkeypatch, "acme_failing")
    monkeypatch.setattr(commands, "entry_points", only("count", "acme_failing"))
    assert main(["count", "41"]) == 2
    error = capsys.readouterr().err
    assert "the verb 'count' failed: ZeroDivisionError" in error


def test_two_packages_with_one_verb_are_rejected(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(commands, "entry_points", only("train", "acme_train"))
    assert main(["plugins"]) == 2
    assert "the verb 'train' is offered twice" in capsys.readouterr().err
