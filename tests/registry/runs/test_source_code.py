"""The commit that a run was made with."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

from registry.runs.origin import checkout, package_source

ROOT = Path(__file__).parents[3]


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
    (tmp_path / "runs" / ".git").write_text("gitdir: nowhere")
    assert checkout(tmp_path / "runs") is None


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="not a checkout")
def test_a_checkout_of_this_project_names_its_commit() -> None:
    here = checkout()
    assert here is not None
    assert here["commit"] == git(ROOT, "rev-parse", "HEAD")


def test_the_commit_of_plugin_packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Installed from a repository, editable from a checkout, from an index, or not at all."""
    source = tmp_path / "repository" / "package"
    source.mkdir(parents=True)
    (source / "a.py").write_text("1")
    git(tmp_path / "repository", "init", "-q")
    git(source, "add", "-A")
    git(source, "commit", "-q", "-m", "first")
    editable = {"url": source.as_uri(), "dir_info": {"editable": True}}
    notes: dict[str, Any] = {
        "cloned": {"url": "https://x.org/y", "vcs_info": {"vcs": "git", "commit_id": "abc"}},
        "edited": editable,
        "copied": {"url": source.as_uri(), "dir_info": {}},
        "strange": {"url": tmp_path.as_uri(), "dir_info": {"editable": True}},
    }
    for name, noted in notes.items():
        metadata = tmp_path / "site" / f"{name}-1.dist-info"
        metadata.mkdir(parents=True)
        (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1\n")
        (metadata / "direct_url.json").write_text(json.dumps(noted))
    monkeypatch.syspath_prepend(tmp_path / "site")
    commit = git(source, "rev-parse", "HEAD")
    assert package_source("cloned") == {"commit": "abc", "dirty": False}
    assert package_source("edited") == {"commit": commit, "dirty": False}
    (source / "a.py").write_text("2")
    assert package_source("edited") == {"commit": commit, "dirty": True}
    for name in ("copied", "strange", "torch", "no-such-package"):
        assert package_source(name) is None


def test_installed_packages_have_no_commit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    git(tmp_path, "init", "-q")
    installed = tmp_path / "site-packages"
    installed.mkdir()
    assert checkout(installed) is None
    assert checkout(tmp_path) is None, "nothing is committed"
    monkeypatch.setenv("PATH", "")
    assert checkout() is None
