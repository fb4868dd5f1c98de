"""The tutorial's commands do, in the order in which they stand, what the page says: `make tutorial`."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.data import data_folder
from tests.test_docs import ROOT, blocks

PAGE = ROOT / "docs" / "tutorial.md"
SETTING_UP = ("git clone", "make ", "source ")
"""How commands begin that make the environment in which this test runs."""
REFUSED = "# refused"
"""What the page writes behind a command that is to fail."""


def commands() -> list[str]:
    lines = (line for block in blocks(PAGE, "sh") for line in block.splitlines())
    return [line for line in lines if not line.startswith(SETTING_UP)]


@pytest.mark.proof
def test_its_commands_run_as_written(tmp_path: Path) -> None:
    data = data_folder("llff_fern").parent
    environment = os.environ | {
        "STEREOGS_DATA": str(data),
        "STEREOGS_CACHE": str(tmp_path / "cache"),
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
    }
    done = []
    for command in commands():
        answer = subprocess.run(
            ["bash", "-c", command],
            cwd=tmp_path,
            env=environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
        )
        expected = 2 if REFUSED in command else 0
        assert answer.returncode == expected, f"{command}\n{answer.stdout}{answer.stderr}"
        if expected:
            assert command.partition(f"{REFUSED}: ")[2] in answer.stderr
        if command.startswith("stereogs demo"):
            page, *yours = answer.stdout.splitlines()[-3:]
            assert (tmp_path / page.split()[1]).is_file()
            assert [line.split()[:3] for line in yours] == [
                ["stereogs", "check", "FOLDER"],
                ["stereogs", "train", "FOLDER"],
            ]
        done.append(command)
    assert len(done) > 10
    promised = re.findall(r"^\| `([^`]+)` \|", PAGE.read_text("utf-8"), re.MULTILINE)
    assert "report.html" in promised
    missing = [name for name in promised if not (tmp_path / "runs" / "first" / name).exists()]
    assert missing == ["failures/"], "nothing failed, and all else is there"
