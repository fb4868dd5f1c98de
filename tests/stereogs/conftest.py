"""Fixtures of the tests of the application; those of the host's tests too."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.registry.conftest import (
    TOY_ENTRIES,
    Install,
    _no_installed_plugins,
    device,
    extension_points,
    install,
    toys,
)

__all__ = ["_no_installed_plugins", "device", "extension_points", "install", "pipeline", "toys"]

PIPELINE = """\
name: toy
scene: toy_scene
initializer: toy_points
regularizers: [toy_term]
metrics: [psnr]
exporters: [toy_files]
training: {iterations: 5, sh_degree: 0}
"""


@pytest.fixture
def pipeline(install: Install, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a pipeline file in an otherwise empty working folder; the toy plugin is installed."""
    install("toys", "1.5", TOY_ENTRIES)
    folder = tmp_path / "work"
    folder.mkdir()
    monkeypatch.chdir(folder)
    path = folder / "toy.yaml"
    path.write_text(PIPELINE)
    return path
