"""PLY files with opacities, lengths or colours in place of logits, logarithms and SH coefficients."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.lib.recfunctions import append_fields, drop_fields
from plyfile import PlyData, PlyElement

from core_rasterizer import SH_C0, Gaussians
from core_rasterizer.layout import PARAMETERS
from core_rasterizer.ply import holds_gaussians, load_ply, save_ply
from tests.core_rasterizer.scenes import random_gaussians


def trained(count: int = 60) -> Gaussians:
    """Gaussians as after training: some are dark, some transparent, most small."""
    generator = torch.Generator().manual_seed(count)
    plain = random_gaussians(count, 1, 0)
    opacities = 0.005 + 0.99 * torch.rand(count, generator=generator)
    scales = 0.5 * torch.rand(count, 3, generator=generator) ** 3 + 1e-5
    sh = torch.cat(
        [(torch.rand(count, 1, 3, generator=generator) - 0.5) / SH_C0, plain.sh[:, 1:]], 1
    )
    return Gaussians(plain.means, scales.log(), plain.quaternions, opacities.logit(), sh)


def with_values(path: Path, gaussians: Gaussians, *stored: str) -> Path:
    """Save Gaussians as other programs do, with the named values in place of those of 3DGS."""
    save_ply(gaussians, path)
    rows = np.array(PlyData.read(str(path))["vertex"].data)
    if "lengths" in stored:
        for name in ("scale_0", "scale_1", "scale_2"):
            rows[name] = np.exp(rows[name])
    if {"opacities", "bytes"} & {*stored}:
        rows["opacity"] = 1 / (1 + np.exp(-rows["opacity"]))
    if "bytes" in stored:
        rows["opacity"] *= 255
    for channel, name in enumerate(("red", "green", "blue")):
        color = rows[f"f_dc_{channel}"] * SH_C0 + 0.5
        if "bytes" in stored:
            rows[f"f_dc_{channel}"] = np.round(255 * color)
        elif "colours" in stored:
            rows[f"f_dc_{channel}"] = color
        elif "plain" in stored:
            rows = append_fields(rows, name, np.round(255 * color).astype("u1"), usemask=False)
            rows = drop_fields(rows, f"f_dc_{channel}")
    PlyData([PlyElement.describe(rows, "vertex")]).write(str(path))
    return path


@pytest.mark.parametrize(
    ("stored", "named"),
    [
        ((), ()),
        (("opacities",), ("opacities in [0, 1]",)),
        (("lengths",), ("scales as lengths",)),
        (("bytes",), ("opacities up to 255 and colours up to 255",)),
        (("plain",), ()),
        (
            ("lengths", "opacities", "colours"),
            ("scales as lengths", "opacities in [0, 1]", "colours up to 1"),
        ),
    ],
    ids=lambda names: "-".join(names),
)
@pytest.mark.parametrize("unit", [1, 1000], ids=["metres", "millimetres"])
def test_activated_values_are_converted(
    stored: tuple[str, ...],
    named: tuple[str, ...],
    unit: float,
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
) -> None:
    plain = trained()
    gaussians = replace(
        plain, means=unit * plain.means, log_scales=plain.log_scales + math.log(unit)
    )
    path = with_values(tmp_path / "scene.ply", gaussians, *stored)
    loaded = load_ply(path)
    assert holds_gaussians(path)
    for what in named:
        assert what in caplog.text
    assert bool(named) == bool(caplog.text)
    tolerance = 0.01 if {"bytes", "plain"} & {*stored} else 1e-4
    for field in PARAMETERS:
        found, expected = getattr(loaded, field), getattr(gaussians, field)
        torch.testing.assert_close(found, expected, atol=tolerance, rtol=1e-4)


def test_values_that_may_be_either_are_kept_and_named(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    few = replace(trained(2), opacity_logits=torch.tensor([0.5, 0.5]))
    loaded = load_ply(with_values(tmp_path / "few.ply", few))
    assert torch.equal(loaded.opacity_logits, few.opacity_logits)
    assert "perhaps stores opacities in [0, 1]" in caplog.text
    caplog.clear()
    own = replace(trained(), opacity_logits=torch.rand(60), log_scales=torch.rand(60, 3))
    save_ply(own, tmp_path / "own.ply")  # its comment says that it stores logits
    assert torch.equal(load_ply(tmp_path / "own.ply").log_scales, own.log_scales)
    assert "perhaps stores scales as lengths and opacities in [0, 1]" in caplog.text
    caplog.clear()
    opaque = replace(trained(), opacity_logits=torch.ones(60))
    loaded = load_ply(with_values(tmp_path / "opaque.ply", opaque))
    assert (torch.sigmoid(loaded.opacity_logits) == 1).all()
