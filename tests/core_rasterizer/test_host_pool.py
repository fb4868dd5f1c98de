"""Memory of images is used again, and never while a tensor still shows it."""

from __future__ import annotations

import resource

import torch

from core_rasterizer import Adam, Device, GaussianModel, open_device, photometric_loss
from core_rasterizer.device.host_pool import ALIGNMENT, KEPT, SMALLEST, HostPool
from tests.core_rasterizer.scenes import parameters, random_camera
from tests.core_rasterizer.training import RATES

SHAPE = (128, 256)


def test_memory_returns_with_the_last_tensor_that_shares_it() -> None:
    pool = HostPool()
    first = pool.empty(SHAPE, torch.float32)
    address, row = first.data_ptr(), first[5]
    assert address % ALIGNMENT == 0
    del first
    other = pool.empty(SHAPE, torch.float32)
    assert other.data_ptr() != address
    row.fill_(3.0)
    del row
    used = pool.empty(SHAPE, torch.float32)
    assert used.data_ptr() == address
    assert (used[5] == 3).all()
    again = pool.empty((*SHAPE, 1), torch.float64)
    assert again.dtype == torch.float64
    assert again.data_ptr() != address


def test_few_blocks_and_only_large_ones_are_kept() -> None:
    pool = HostPool()
    tensors = [pool.empty((SMALLEST + n,), torch.uint8) for n in range(3 * KEPT)]
    tensors.append(pool.empty((SMALLEST - 1,), torch.uint8))
    del tensors
    assert len(pool._free) == KEPT


def test_an_image_keeps_its_values_while_later_ones_are_rendered(device: Device) -> None:
    model = GaussianModel(parameters(50), device)
    cameras = [random_camera(torch.Generator().manual_seed(n), 160, 120) for n in range(4)]
    with torch.no_grad():
        images = [model.render(camera).rgb for camera in cameras]
        copies = [image.clone() for image in images]
        for camera in cameras:
            model.render(camera)
    device.finish()
    assert all(map(torch.equal, images, copies))


def test_an_iteration_takes_no_new_pages() -> None:
    """Without the pool, 1,600x1,200 pixels fault 15,000 times."""
    engine = open_device()
    model = GaussianModel(parameters(50), engine)
    optimizer, target = Adam(model), torch.rand(1200, 1600, 3)
    camera = random_camera(torch.Generator().manual_seed(0), 1600, 1200)
    faults = []
    for _ in range(4):
        model.zero_gradients()
        photometric_loss(model.render(camera), target).backward()
        optimizer.step(RATES, active_sh_degree=3)
        engine.finish()
        faults.append(resource.getrusage(resource.RUSAGE_SELF).ru_minflt)
    assert faults[-1] - faults[-2] < 1000
