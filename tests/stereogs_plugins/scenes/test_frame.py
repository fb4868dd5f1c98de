"""Origin and unit of the files do not matter, and results are in the coordinates of the files."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

import stereogs
from core_rasterizer import load_ply
from stereogs.api import Run
from tests.stereogs_plugins.scenes.small_scenes import (
    DTU_VIEWS,
    World,
    write_blender,
    write_colmap,
    write_dtu,
    write_llff,
    write_nerfstudio,
)

Writer = Callable[[Path, World], Path]
WRITERS: dict[str, tuple[Writer, str, int]] = {
    "llff": (write_llff, "train_views: 3, downsample: 2", 9),
    "colmap": (write_colmap, "train_views: 3, test_every: 4", 9),
    "nerfstudio": (write_nerfstudio, "train_views: 3, test_every: 4", 9),
    "blender": (write_blender, "train_ids: [0, 4, 8], test_every: 4", 9),
    "dtu": (write_dtu, "train_views: 3", DTU_VIEWS),
}
PLACES = {
    "far": ((1e4, -1e4, 250.0), 1.0),
    "survey": ((499_123.4, 5.4e6, 312.7), 1.0),
    "farthest": ((6e6, 6e6, -6e6), 1000.0),
    "close-up": ((0.0, 0.0, 0.0), 1e-3),
    "small": ((-3.0, 0.2, 10.0), 0.07),
    "large": ((10.0, 0.0, 0.0), 30.0),
}
EXACT = ((2048.0, -512.0, 64.0), 0.125)
"""Powers of two, which floating-point numbers hold without rounding."""


def trained(folder: Path, name: str, origin: tuple[float, float, float], unit: float) -> Run:
    write, settings, count = WRITERS[name]
    scene = f"{{use: {name}, path: {write(folder, World(count, origin=origin, unit=unit))}, {settings}}}"
    pipeline = {
        "name": "tiny",
        "initializer": {"use": "random", "count": 300},
        "regularizers": [{"use": "parameter_l1", "parameter": "scales"}],
        "training": {"iterations": 25, "sh_degree": 0},
        "metrics": [{"use": "psnr"}],
    }
    built = stereogs.build_pipeline(pipeline, [f"scene={scene}"])
    return stereogs.train(built, progress=False)


@pytest.mark.proof
@pytest.mark.parametrize("name", WRITERS)
def test_scores_do_not_depend_on_origin_and_unit(name: str, tmp_path: Path) -> None:
    plain = trained(tmp_path / "plain", name, (0.0, 0.0, 0.0), 1.0)
    expected = plain.scores["test"].mean["psnr"]
    for place, (origin, unit) in PLACES.items():
        run = trained(tmp_path / place, name, origin, unit)
        assert run.scores["test"].mean["psnr"] == pytest.approx(expected, abs=0.2), place


@pytest.mark.parametrize("name", ["llff", "nerfstudio", "blender"])
def test_exact_moves_change_no_bit(name: str, tmp_path: Path) -> None:
    plain = trained(tmp_path / "plain", name, (0.0, 0.0, 0.0), 1.0)
    assert trained(tmp_path / "moved", name, *EXACT).hash == plain.hash


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, Run]:
    """One scene at its origin and in survey coordinates, in units of half a metre."""
    folder = tmp_path_factory.mktemp("survey")
    origin = (499_123.5, 5.4e6, 312.75)
    plain = trained(folder / "plain", "colmap", (0.0, 0.0, 0.0), 1.0)
    return plain, trained(folder / "moved", "colmap", origin, 2.0)


def test_renders_take_cameras_of_the_file(survey: tuple[Run, Run]) -> None:
    _, moved = survey
    here, there = (run.render(run.scene.test[0].camera) for run in survey)
    np.testing.assert_allclose(here.rgb, there.rgb, atol=0.01)
    np.testing.assert_allclose(2 * here.depth, there.depth, atol=0.1)
    alone = stereogs.render(moved.model, moved.scene.test[0].camera)
    np.testing.assert_array_equal(alone.rgb, there.rgb)


def test_the_model_is_in_the_coordinates_of_the_file(survey: tuple[Run, Run]) -> None:
    plain, moved = survey
    origin = torch.tensor([499_123.5, 5.4e6, 312.75], dtype=torch.float64)
    expected = origin + 2 * plain.model.read("means")
    assert (moved.model.read("means") - expected).abs().median() < 1e-3
    assert float(moved.model.scales().median()) == pytest.approx(
        2 * float(plain.model.scales().median()), rel=1e-2
    )


def test_exports_are_in_the_coordinates_of_the_file(
    survey: tuple[Run, Run], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    _, moved = survey
    (ply, *_) = [f for f in stereogs.export(moved, "ply", tmp_path) if f.suffix == ".ply"]
    again = load_ply(ply)
    assert again.means.dtype == torch.float64
    assert torch.equal(again.means, moved.model.gaussians().means)
    stereogs.export(moved, "spz", tmp_path)
    assert "cannot hold the scene's coordinates" in caplog.text
    (glb,) = stereogs.export(moved, "gltf", tmp_path)
    translation = np.array(_node_of(glb)["translation"])
    assert np.linalg.norm(translation) == pytest.approx(math.hypot(499_123.5, 5.4e6), rel=1e-4)


def _node_of(glb: Path) -> dict[str, list[float]]:
    import json
    import struct

    content = glb.read_bytes()
    (length,) = struct.unpack("<I", content[12:16])
    node: dict[str, list[float]] = json.loads(content[20 : 20 + length])["nodes"][0]
    return node


def test_a_resumed_run_keeps_its_frame(survey: tuple[Run, Run], tmp_path: Path) -> None:
    _, moved = survey
    again = stereogs.open_run(moved.save(tmp_path / "run"))
    assert again.frame == moved.frame
    assert again.hash == moved.hash
    camera = moved.scene.test[0].camera
    np.testing.assert_array_equal(again.render(camera).rgb, moved.render(camera).rgb)
