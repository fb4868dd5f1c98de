from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from core_rasterizer import GaussianModel, open_device
from registry import Frame
from stereogs_plugins.exporters.spz import SpzExporter, half_turned
from tests.registry.toolkit.spz_reader import read_spz
from tests.stereogs_plugins.building import build
from tests.stereogs_plugins.exporters.looking import SCENE, colorful, likeness

HALF_TURN = torch.diag(torch.tensor([1.0, -1, -1, 1], dtype=torch.float64))


def test_half_a_turn_of_the_scene_and_of_the_camera_cancel_out() -> None:
    gaussians = colorful()
    assert likeness(gaussians, half_turned(gaussians), HALF_TURN) > 90


def test_what_is_read_back_looks_nearly_the_same(tmp_path: Path) -> None:
    """Opacities, colours and scales have 8 bits: 50.4 dB for these large, bright Gaussians."""
    gaussians = colorful()
    model = GaussianModel(gaussians, open_device())
    (file,) = build(SpzExporter).export(model.reader(), SCENE, tmp_path)
    again, bits = read_spz(file.read_bytes())
    assert bits == 12, "some readers take no other"
    assert likeness(gaussians, again, HALF_TURN) > 50
    turned = gaussians.means * torch.tensor([1.0, -1, -1])
    assert float((again.means - turned).abs().max()) <= 0.5 / 4096 + 1e-6


def test_a_distant_sky_does_not_coarsen_the_scene(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    gaussians = colorful()
    gaussians.means[0] = torch.tensor([0.0, 0, 1e6])
    gaussians.log_scales[0] = math.log(1e5)
    gaussians.opacity_logits[0] = 5
    model = GaussianModel(gaussians, open_device())
    (file,) = build(SpzExporter).export(model.reader(), SCENE, tmp_path)
    assert "1 of 60 Gaussians, farther away than 2047 units" in caplog.text
    again, bits = read_spz(file.read_bytes())
    assert bits == 12
    read = Frame.around(gaussians).gaussians_in_file(half_turned(again))
    assert likeness(gaussians, replace(read, means=read.means.float())) > 45
