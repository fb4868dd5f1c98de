"""PLY files with finite values that single precision cannot render."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from plyfile import PlyData, PlyElement

from core_rasterizer import Camera, Device, GaussianModel, Gaussians, PlyError, reference
from core_rasterizer.layout import PARAMETERS
from core_rasterizer.ply import load_ply, save_ply
from tests.core_rasterizer.scenes import activated, parameters, relative_error

COUNT, ROW = 200, 7
SCALES = ("scale_0", "scale_1", "scale_2")
ROTATION = ("rot_0", "rot_1", "rot_2", "rot_3")


def written(path: Path, values: dict[str, float], rows: int | slice) -> Path:
    """A scene of which some rows have other values, by property."""
    save_ply(parameters(COUNT), path)
    saved = PlyData.read(str(path))
    vertices = np.array(saved["vertex"].data)
    for name, value in values.items():
        vertices[name][rows] = value
    described = PlyElement.describe(vertices, "vertex")
    PlyData([described], comments=saved.comments).write(str(path))
    return path


@pytest.mark.parametrize(
    ("values", "what"),
    [
        ({"x": 1e30}, "x, y or z"),
        ({"x": -3e38, "y": 3e38, "z": 3e38}, "x, y or z"),
        (dict.fromkeys(SCALES, 20), "scale_0 to scale_2"),
        ({"scale_1": 100}, "scale_0 to scale_2"),
        ({"scale_0": 3e38}, "scale_0 to scale_2"),
        ({"scale_0": -1000, "scale_1": 60, "scale_2": -1000}, "scale_0 to scale_2"),
        ({"f_dc_1": 1e38}, "f_dc or f_rest"),
        ({"f_rest_44": -3e38}, "f_dc or f_rest"),
    ],
    ids=str,
)
def test_gaussians_that_overflow_are_left_out(
    values: dict[str, float], what: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    loaded = load_ply(written(tmp_path / "one.ply", values, ROW))
    assert "left out 1 of 200" in caplog.text
    assert f": 1 in {what} (first: vertex {ROW})" in caplog.text
    others = torch.arange(COUNT) != ROW
    for field in PARAMETERS:
        assert torch.equal(getattr(loaded, field), getattr(parameters(COUNT), field)[others]), field
    with pytest.raises(PlyError, match=f"all Gaussians overflow .*200 in {what}"):
        load_ply(written(tmp_path / "all.ply", values, slice(None)))


@pytest.mark.parametrize(
    "values",
    [
        {"x": 1e5, "z": 1e6},
        {"x": 1e6, **dict.fromkeys(SCALES, 13)},
        {"z": 1e12, **dict.fromkeys(SCALES, 26)},
        {"opacity": 1e4},
        {"opacity": -3e38},
        {"scale_0": -1000},
        {"scale_0": -3e38, "scale_1": 5},
        {"f_dc_0": -1e20, "f_rest_3": 1e20},
        dict.fromkeys(ROTATION, 1e-11),
        dict.fromkeys(ROTATION, 1e18),
    ],
    ids=str,
)
def test_values_that_can_be_rendered_keep_their_bits(
    values: dict[str, float], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = written(tmp_path / "scene.ply", values, ROW)
    save_ply(load_ply(path), tmp_path / "again.ply")
    again = PlyData.read(str(tmp_path / "again.ply"))["vertex"].data
    assert again.tobytes() == PlyData.read(str(path))["vertex"].data.tobytes()
    assert not caplog.text


@pytest.mark.parametrize("length", [1e-44, 1e-30, 1e-13, 1e19, 1e38])
def test_quaternions_of_extreme_length_become_unit_quaternions(
    length: float, tmp_path: Path
) -> None:
    given = torch.tensor([1.0, -2.0, 0.0, 2.0])
    values = dict(zip(ROTATION, (length * given).tolist(), strict=True))
    found = load_ply(written(tmp_path / "scene.ply", values, ROW)).quaternions
    tolerance = 0.1 if length < 1e-43 else 1e-7  # the smallest float is 1.4e-45
    torch.testing.assert_close(found[ROW], given / 3, atol=tolerance, rtol=0)
    expected = parameters(COUNT).quaternions.index_copy(0, torch.tensor([ROW]), found[ROW][None])
    assert torch.equal(found, expected)


def test_missing_rotations_and_thicknesses_can_be_trained(tmp_path: Path) -> None:
    values = {**dict.fromkeys(ROTATION, 0.0), "scale_1": -math.inf}
    loaded = load_ply(written(tmp_path / "scene.ply", values, ROW))
    assert loaded.quaternions[ROW].tolist() == [1, 0, 0, 0]
    assert torch.isfinite(loaded.log_scales).all()
    assert 0 < float(loaded.log_scales[ROW, 1].exp()) < 1e-37


CAMERA = Camera(torch.eye(4, dtype=torch.float64), 1000.0, 1000.0, 20.0, 14.0, 40, 28)


def ring(depth: float, log_scale: float, coefficient: float) -> Gaussians:
    """A Gaussian on the optical axis, and others at distance 1 around it, outside of the picture."""
    angles = 2 * math.pi * torch.arange(40) / 40
    means = torch.stack([angles.cos(), angles.sin(), torch.ones(40)], dim=1)
    means[0] = torch.tensor([0.0, 0.0, depth])
    sh = torch.zeros(40, 4, 3)
    sh[:, 0, 0], sh[:, 2, 1] = 1.0, 1.0  # green depends on z
    sh[0, 0, 2] = coefficient
    log_scales = torch.full((40, 3), -7.0)
    log_scales[0] = log_scale
    quaternions = torch.tensor([[1.0, 0, 0, 0]]).repeat(40, 1)
    return Gaussians(means, log_scales, quaternions, torch.ones(40), sh)


@pytest.mark.parametrize(
    ("name", "largest", "wrong"),
    [("depth", 3.1e18, 3e19), ("log_scale", 14.38, 14.40), ("coefficient", 8.8e36, 3.6e37)],
)
def test_what_is_kept_is_rendered_and_what_is_left_out_is_not(
    name: str, largest: float, wrong: float, device: Device, tmp_path: Path
) -> None:
    """The bounds are those of the kernels, for a scene that covers a thousand pixels."""
    plain = {"depth": 1.0, "log_scale": 0.0, "coefficient": 0.0}
    for value, count in ((largest, 40), (wrong, 39)):
        gaussians = ring(**{**plain, name: value})
        truth = reference.render(*activated(gaussians), CAMERA).rgb
        found = GaussianModel(gaussians, device).render(CAMERA).rgb
        assert (relative_error(found, truth) < 1e-5) == (value == largest)
        save_ply(gaussians, tmp_path / "scene.ply")
        assert len(load_ply(tmp_path / "scene.ply")) == count


def test_units_do_not_matter(tmp_path: Path) -> None:
    """The bound of scales is relative to the scene."""
    for exponent in (-20, 20):
        for log_scale, count in ((14.3, 40), (14.5, 39)):
            scene = ring(1.0, log_scale, 0.0)
            means = scene.means * 2.0**exponent
            log_scales = scene.log_scales + exponent * math.log(2)
            save_ply(replace(scene, means=means, log_scales=log_scales), tmp_path / "scene.ply")
            assert len(load_ply(tmp_path / "scene.ply")) == count
