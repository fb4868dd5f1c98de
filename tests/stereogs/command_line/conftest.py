"""Fixtures of the tests of verbs."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.registry.conftest import TOY_ENTRIES, Install

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
