"""Devices without double precision: positions are sums of two floats, with the accuracy of others."""

from __future__ import annotations

import pytest
import torch

from core_rasterizer import Camera, Device, DeviceError, rasterize, reference
from core_rasterizer.device import program
from tests.core_rasterizer.scenes import fresh, random_camera, random_scene, relative_error

ACCURACY = 1e-6
"""As `test_rasterize.py` asks of devices with double precision."""


@pytest.fixture
def single(device: Device) -> Device:
    """The device, treated as one without double precision."""
    copy = device.as_variant(device.variant)
    copy.supports_double = False
    return copy


def worst_error(device: Device) -> float:
    """Of depth and alpha of 300 Gaussians, 70 units from the origin of the world."""
    errors = []
    for seed in range(3):
        generator = torch.Generator().manual_seed(seed)
        scene, camera = random_scene(generator, 300), random_camera(generator, 90, 70)
        away = torch.tensor([50.0, -30.0, 40.0], dtype=torch.float64)
        scene.means += away
        pose = camera.world_to_camera.clone()
        pose[:3, 3] -= pose[:3, :3] @ away
        numbers = (camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height)
        moved, leaves = Camera(pose, *numbers), scene.tensors(torch.float32)
        truth = reference.render(*fresh(leaves), moved)
        rendering = rasterize(*leaves, moved, device=device)
        for name in ("depth", "alpha"):  # view directions of colours are single in any case
            errors.append(relative_error(getattr(rendering, name), getattr(truth, name)))
    return max(errors)


def test_images_are_as_accurate_as_with_double(single: Device) -> None:
    assert worst_error(single) < ACCURACY


def test_single_floats_would_not_be(single: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    original = program._source

    def without_pairs(name: str) -> str:
        return original(name).replace("#ifdef NO_DOUBLE", "#if 0")

    monkeypatch.setattr(program, "_source", without_pairs)
    assert worst_error(single) > 3 * ACCURACY


def test_double_is_refused(single: Device) -> None:
    with pytest.raises(DeviceError, match="does not support double precision"):
        single.program("raster/scan", dtype=torch.float64)
