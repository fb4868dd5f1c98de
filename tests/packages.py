"""Packages that tests install for real: built by setuptools, installed by pip, run by another Python."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.host import SELECTION, Plugins

ROOT = Path(__file__).parent.parent
_PIP = ("-m", "pip", "--disable-pip-version-check", "install", "-q", "--no-deps", "--no-index")
_BUILD = """
import os, sys
from setuptools import build_meta
_, wheels, *folders = sys.argv  # setuptools changes the list
for folder in folders:
    os.chdir(folder)
    build_meta.build_wheel(os.path.join(wheels, os.path.basename(folder)))
"""


def run_python(*command: str, folder: Path, site: Path | None = None) -> str:
    """The output of a Python command that must succeed.

    Args:
        folder: where it runs.
        site: a further folder of installed packages.
    """
    environment = {**os.environ, "PYTHONPATH": f"{site or folder}:{ROOT}"}
    environment.pop(SELECTION, None)
    done = subprocess.run(
        [sys.executable, *command],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def install(packages: Sequence[Path], folder: Path) -> Path:
    """Install copies of packages, all at once, which is quicker than one by one.

    Args:
        packages: their folders.
        folder: for all that is made on the way.

    Returns:
        The folder that they are installed in.
    """
    copies, wheels, site = folder / "sources", folder / "wheels", folder / "site"
    for package in packages:
        shutil.copytree(package, copies / package.name)
    run_python("-c", _BUILD, str(wheels), *map(str, copies.iterdir()), folder=folder)
    built = [str(wheel) for wheel in wheels.rglob("*.whl")]
    assert len(built) == len(packages)
    run_python(*_PIP, "--target", str(site), *built, folder=folder)
    return site


def install_by_pip(package: Path, folder: Path) -> Path:
    """Install one package as its user would; returns the folder that it is installed in."""
    site = folder / "site"
    run_python(*_PIP, "--no-build-isolation", "--target", str(site), str(package), folder=folder)
    return site


@contextmanager
def importable(site: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Plugins]:
    """All plugins, with those of `install`; the modules of `site` are forgotten afterwards."""
    before = set(sys.modules)
    monkeypatch.syspath_prepend(site)
    monkeypatch.delenv(SELECTION, raising=False)
    yield Plugins()
    for name in set(sys.modules) - before:
        file = getattr(sys.modules[name], "__file__", None)
        if file and Path(file).is_relative_to(site):
            del sys.modules[name]
