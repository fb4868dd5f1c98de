"""Completions for an incomplete command line."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.host import main

Capture = pytest.CaptureFixture[str]


def completed(line: str, folder: Path) -> list[str]:
    """Return the completions for a command line."""
    answer = folder / "answer"
    environment = {
        **{key: value for key, value in os.environ.items() if key != "STEREOGS_PLUGINS"},
        **{"_ARGCOMPLETE": "1", "_ARGCOMPLETE_IFS": "\n", "_ARGCOMPLETE_SHELL": "fish"},
        **{"_ARGCOMPLETE_STDOUT_FILENAME": str(answer), "_ARGCOMPLETE_SUPPRESS_SPACE": "1"},
        **{"COMP_LINE": line, "COMP_POINT": str(len(line)), "COMP_TYPE": "9"},
    }
    code = "from stereogs.cli import main; main()"
    subprocess.run([sys.executable, "-c", code], env=environment, cwd=folder, check=True)
    return [text.strip() for text in answer.read_text().splitlines()]


def test_a_shell_completes_verbs_pipelines_and_components(tmp_path: Path) -> None:
    (tmp_path / "weight.yaml").touch()
    assert completed("stereogs tra", tmp_path) == ["train"]
    offered = completed("stereogs train weight", tmp_path)
    assert {"weight.yaml", "weightfree", "weightfree_fast"} <= {*offered}
    assert completed("stereogs plugins dropo", tmp_path) == ["dropout"]


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_is_printed(shell: str, capsys: Capture) -> None:
    assert main(["completion", shell]) == 0
    assert "stereogs" in capsys.readouterr().out
