"""Verbs, the application's own and those of other packages."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path

import pytest

from stereogs.command_line import installed as commands
from stereogs.command_line.installed import COMMANDS, verbs
from tests.host import main, parse_command

EXAMPLES = {
    "train": ["train", "3dgs"],
    "resume": ["resume", "runs/x"],
    "eval": ["eval", "runs/x"],
    "explain": ["explain", "3dgs"],
    "init": ["init", "mine"],
    "ablate": ["ablate", "ablations/parts"],
    "bench": ["bench", "matrix.yaml"],
    "benchmark": ["benchmark", "matrix.yaml"],
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


def test_every_verb_parses_its_arguments() -> None:
    for verb in verbs():
        parsed = parse_command(EXAMPLES.get(verb, [verb]))
        assert callable(parsed.command.run)


def test_help_lists_every_verb_and_imports_little() -> None:
    code = (
        "import sys\nfrom stereogs.cli import main\n"
        "try:\n    main(['--help'])\nexcept SystemExit:\n    pass\n"
        "tops = ('stereogs_plugins', 'stereogs.verbs', 'torch')\n"
        "print([m for m in sys.modules if m.startswith(tops)])"
    )
    output = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout
    assert output.splitlines()[-1] == "[]"
    for name, verb in verbs().items():
        assert f"    {name}" in output
        assert verb.summary


MODULE = '''"""Count the Gaussians of a run."""

from stereogs.api import Command, hookimpl


class Count(Command):
    """The verb `count`."""

    def add_arguments(self, parser):
        parser.add_argument("number", type=int)

    def run(self, arguments):
        print(arguments.number + 1)
        return 0


@hookimpl
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
    words = capsys.readouterr().out.split()  # Pythons indent the list differently
    assert "count count the Gaussians of a run" in " ".join(words)


@pytest.mark.parametrize(
    ("source", "what"),
    [
        ("import nothing_of_this_name", "cannot be imported: ModuleNotFoundError"),
        (
            MODULE.replace("{name}", "cont").replace("{cls}", "Count"),
            "registers cont, not 'broken'",
        ),
        (
            MODULE.replace("{name}", "broken").replace("{cls}", "int"),
            "not a subclass of stereogs.api",
        ),
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
