"""Training is bit-identical for any number of threads."""

from __future__ import annotations

import os
import subprocess
import sys
from functools import cache

import pytest
import torch

from core_rasterizer import Device, GaussianModel, photometric_loss
from core_rasterizer.device import DeviceProfile
from tests.core_rasterizer.scenes import gradient, parameters, view
from tests.core_rasterizer.training import short_training


@cache
def digest(device: Device) -> str:
    return short_training(device)


def test_three_runs_give_one_digest(device: Device) -> None:
    assert {short_training(device) for _ in range(2)} == {digest(device)}


def with_units(device: Device, units: int) -> Device:
    """The same device as if it had another number of compute units."""
    engine = device.as_variant(device.variant)
    engine.compute_units = units
    engine.profile = DeviceProfile.for_device(engine.variant, units)
    return engine


@pytest.mark.parametrize("units", [1, 4])
def test_one_and_four_compute_units_give_one_digest(device: Device, units: int) -> None:
    assert short_training(with_units(device, units)) == digest(device)


@pytest.mark.parametrize("height", [7, 90, 378])
def test_the_loss_is_the_same_for_any_number_of_compute_units(device: Device, height: int) -> None:
    generator = torch.Generator().manual_seed(0)
    rgb, target = torch.rand(2, height, 31, 3, generator=generator)
    results = []
    for units in (1, 2, 16, 64):
        leaf = rgb.clone().requires_grad_()
        loss = photometric_loss(leaf, target, device=with_units(device, units))
        loss.backward()
        results.append((loss.detach(), gradient(leaf)))
    for number, slope in results[1:]:
        assert torch.equal(number, results[0][0])
        assert torch.equal(slope, results[0][1])


@pytest.mark.parametrize("units", [16, 64])
def test_many_compute_units_render_the_same_image_up_to_rounding(
    device: Device, units: int
) -> None:
    """Tiles are smaller then, and chunks and launches others."""
    gaussians, images = parameters(20_000), []
    for engine in (device, with_units(device, units)):
        with torch.no_grad():
            images.append(GaussianModel(gaussians, engine).render(view()).rgb)
    assert torch.allclose(images[0], images[1], atol=1e-5)


@pytest.mark.proof
def test_one_thread_and_two_threads_give_one_digest() -> None:
    """In new processes, because PoCL reads its number of threads when it is loaded."""
    units, digests = [], []
    for threads in ("1", "2"):
        settings = {"POCL_MAX_PTHREAD_COUNT": threads, "POCL_CPU_MAX_CU_COUNT": threads}
        output = subprocess.run(
            [sys.executable, "-m", "tests.core_rasterizer.training"],
            env=os.environ | settings,
            check=True,
            capture_output=True,
            text=True,
        ).stdout
        runs = [line.split("\t") for line in output.splitlines()]
        units.append({int(run[0]) for run in runs})
        digests.append([run[1:] for run in runs])
    assert digests[0]
    assert digests[0] == digests[1]
    # One thread was one thread, at least where the settings are understood.
    assert 1 in units[0] or units[0] == units[1]
