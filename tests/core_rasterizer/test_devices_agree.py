"""All installed OpenCL runtimes render the same image."""

from __future__ import annotations

import itertools

import pytest
import torch

from core_rasterizer import list_devices, rasterize
from tests.core_rasterizer.scenes import random_camera, random_scene


def test_devices_show_the_same_picture() -> None:
    """At least 100 dB between any two: only rounding differs."""
    devices = list_devices()
    if len(devices) < 2:
        pytest.skip(f"only one OpenCL device is installed: {devices[0].name}")
    generator = torch.Generator().manual_seed(11)
    scene, camera = random_scene(generator, 2000), random_camera(generator, 320, 240)
    images = {
        f"{device.name} ({device.platform})": rasterize(
            *scene.tensors(torch.float32), camera, device=device
        ).rgb.detach()
        for device in devices
    }
    for (one, first), (other, second) in itertools.combinations(images.items(), 2):
        mse = float((first.double() - second.double()).square().mean())
        assert mse <= 1e-10, f"{one} and {other}: mean squared difference {mse:g}"
