"""Devices without shared memory: the same results, and no transfers of Gaussian arrays.

Without such a device, `as_discrete` emulates one on the CPU.
"""

from __future__ import annotations

import pytest
import torch

from core_rasterizer import Adam, Device, GaussianModel, photometric_loss
from core_rasterizer.device import DeviceArray
from tests.core_rasterizer.scenes import parameters, random_camera
from tests.core_rasterizer.training import RATES, short_training

WIDTH, HEIGHT = 120, 90
PIXEL = 4 * 3
"""Bytes of a pixel's colour."""


def bytes_of_an_iteration(device: Device, count: int) -> int:
    """Transfers of one iteration in steady state."""
    generator = torch.Generator().manual_seed(0)
    model = GaussianModel(parameters(count), device)
    optimizer = Adam(model)
    camera = random_camera(generator, WIDTH, HEIGHT)
    target = torch.rand(HEIGHT, WIDTH, 3, generator=generator)
    for _ in range(3):
        device.finish()
        before = device.bytes_moved
        model.zero_gradients()
        rendering = model.render(camera, collect_statistics=True)
        loss = photometric_loss(rendering, target)
        (loss + 0.01 * rendering.depth.mean()).backward()
        optimizer.step(RATES, active_sh_degree=3)
    device.finish()
    return device.bytes_moved - before


def test_the_bytes_of_an_iteration_do_not_grow_with_the_gaussians(device: Device) -> None:
    discrete = device.as_discrete()
    few, many = bytes_of_an_iteration(discrete, 100), bytes_of_an_iteration(discrete, 3000)
    assert few == many
    # Out and in again: depth and its gradient, for the second loss term.
    assert few <= 1.1 * 2 / 3 * WIDTH * HEIGHT * PIXEL


def test_nothing_is_counted_where_memory_is_shared(device: Device) -> None:
    if device.shares_memory:
        assert bytes_of_an_iteration(device, 100) == 0


def test_a_training_is_the_same_with_and_without_shared_memory(device: Device) -> None:
    """Renders, losses, gradients, Adam, edits, resets and statistics with copies."""
    assert short_training(device.as_discrete()) == short_training(device)


def test_one_parameter_crosses_without_the_others(device: Device) -> None:
    discrete = device.as_discrete()
    model = GaussianModel(parameters(100), discrete)
    row = 4 * model.capacity
    for name, rows in (("opacity_logits", 1), ("means", 3), ("sh", 48)):
        before = discrete.bytes_moved
        values = model.read(name)
        assert discrete.bytes_moved - before == rows * row
        model.write(name, values + 1)
        assert discrete.bytes_moved - before == 2 * rows * row
        assert torch.equal(model.read(name), values + 1)


@pytest.mark.parametrize("shared", [True, False])
def test_rows_are_read_and_written_alone(device: Device, shared: bool) -> None:
    array = DeviceArray(device if shared else device.as_discrete(), (4, 5), torch.int32)
    array.write(torch.full((2, 5), 7), 1, 3)
    assert array.read().tolist() == [[0] * 5, [7] * 5, [7] * 5, [0] * 5]
    assert array.read(2, 4).tolist() == [[7] * 5, [0] * 5]
    assert array.read(3).tolist() == [[0] * 5]
