from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from core_rasterizer import GaussianModel, load_ply, open_device
from registry import PluginError
from stereogs_plugins.exporters.splat_transform import (
    PROGRAM,
    SogExporter,
    stereogs_register_exporters,
)
from tests.stereogs_plugins.building import build, offered
from tests.stereogs_plugins.exporters.looking import SCENE, colorful, likeness


def test_is_offered_by_name() -> None:
    assert offered(stereogs_register_exporters) == {"sog": SogExporter}


def test_without_the_program_the_command_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    folder = tmp_path / "with a space"
    folder.mkdir()
    model = GaussianModel(colorful(5), open_device())
    with pytest.raises(PluginError, match="not on the PATH") as caught:
        build(SogExporter).export(model.reader(), SCENE, folder)
    assert "npx @playcanvas/splat-transform" in caught.value.fix
    assert caught.value.fix.endswith(f"'{folder / 'scene.ply'}' '{folder / 'scene.sog'}'")
    assert len(load_ply(folder / "scene.ply")) == 5


def test_what_the_program_says_is_passed_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = tmp_path / PROGRAM
    program.write_text("#!/bin/sh\necho no room left >&2\nexit 3\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    model = GaussianModel(colorful(5), open_device())
    with pytest.raises(PluginError, match="exit status 3: no room left"):
        build(SogExporter).export(model.reader(), SCENE, tmp_path)


@pytest.mark.skipif(shutil.which(PROGRAM) is None, reason=f"{PROGRAM} is not on the PATH")
def test_the_program_reads_back_what_it_wrote(tmp_path: Path) -> None:
    """SOG draws colours from palettes, which 60 Gaussians of random colours fill badly: 25 dB."""
    gaussians = colorful()
    model = GaussianModel(gaussians, open_device())
    (file,) = build(SogExporter).export(model.reader(), SCENE, tmp_path)
    subprocess.run([PROGRAM, "--quiet", file, tmp_path / "again.ply"], check=True)
    assert likeness(gaussians, load_ply(tmp_path / "again.ply")) > 22
