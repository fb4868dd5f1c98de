"""Installs the packages of `tests/faulty_packages` as pip would."""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Sequence
from importlib.metadata import EntryPoint, distributions
from pathlib import Path

import pytest

from tests.host import GROUP

PACKAGES = Path(__file__).parents[1] / "faulty_packages"
NAMES = sorted(folder.parent.name for folder in PACKAGES.glob("*/pyproject.toml"))


def module(name: str) -> str:
    """Return the name of a package's module."""
    return f"faulty_{name}"


def installed(
    names: Sequence[str], site: Path, monkeypatch: pytest.MonkeyPatch
) -> list[EntryPoint]:
    """Put packages on the path with the metadata that pip would write; return their entry points.

    Args:
        site: a folder for the metadata.
    """
    for name in names:
        folder = PACKAGES / name
        project = tomllib.loads((folder / "pyproject.toml").read_text("utf-8"))["project"]
        metadata = site / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
        metadata.mkdir(parents=True)
        (metadata / "METADATA").write_text(
            f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n"
        )
        (metadata / "top_level.txt").write_text(f"{module(name)}\n")
        lines = [f"{key} = {value}" for key, value in project["entry-points"][GROUP].items()]
        (metadata / "entry_points.txt").write_text("\n".join([f"[{GROUP}]", *lines, ""]))
        monkeypatch.syspath_prepend(folder)
        monkeypatch.delitem(sys.modules, module(name), raising=False)
    found = [e for d in distributions(path=[str(site)]) for e in d.entry_points if e.group == GROUP]
    return sorted(found, key=lambda entry: entry.name)
