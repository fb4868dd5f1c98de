"""The commit that a run was made with."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from registry.runs.origin.source_code import checkout


def git(folder: Path, *arguments: str) -> str:
    identity = ("-c", "user.name=a", "-c", "user.email=a@b")
    command = ["git", "-C", str(folder), *identity, *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def test_the_commit_and_whether_the_packages_differ_from_it(tmp_path: Path) -> None:
    code = tmp_path / "registry" / "a.py"
    code.parent.mkdir()
    code.write_text("1")
    git(tmp_path, "init", "-q")
    git(tmp_path, "add", "-A")
    git(tmp_path, "commit", "-q", "-m", "first")
    commit = git(tmp_path, "rev-parse", "HEAD")
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "results.json").write_text("{}")
    assert checkout(tmp_path) == {"commit": commit, "dirty": False}
    code.with_name("new.py").write_text("2")
    assert checkout(tmp_path) == {"commit": commit, "dirty": True}


def test_installed_packages_have_no_commit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    git(tmp_path, "init", "-q")
    installed = tmp_path / "site-packages"
    installed.mkdir()
    assert checkout(installed) is None
    assert checkout(tmp_path) is None, "nothing is committed"
    monkeypatch.setenv("PATH", "")
    assert checkout() is None
