"""Renders beyond the memory budget raise before allocating."""

from __future__ import annotations

import re
import time
from pathlib import Path

import pyopencl as cl
import pytest
import torch

from core_rasterizer import Camera, CameraError, Device, MemoryBudgetError
from core_rasterizer.device import DeviceArray
from core_rasterizer.layout import padded
from core_rasterizer.raster import Block, Renderer, RenderRequest, pack
from tests.core_rasterizer.scenes import parameters, random_camera

BLACK = (0.0, 0.0, 0.0)


def block_of(device: Device, count: int, log_scale: float = -1.0) -> Block:
    gaussians = parameters(count, sh_degree=0)
    gaussians.log_scales[:] = log_scale
    rows = pack(gaussians, torch.float32, padded(count))
    array = DeviceArray(device, tuple(rows.shape))
    array.write(rows)
    return Block(array, count, activated=False)


def view_of(width: int, height: int) -> RenderRequest:
    return RenderRequest(random_camera(torch.Generator().manual_seed(0), width, height), BLACK, 0)


def test_an_image_beyond_the_budget_raises_before_allocating(device: Device) -> None:
    renderer = Renderer(device, memory_budget=64 * 2**20)
    block = block_of(device, 16)
    with pytest.raises(MemoryBudgetError) as error:
        renderer.forward(block, view_of(8000, 8000))
    assert "the budget is 64 MB" in error.value.what
    stated = re.search(r"needs ([\d,]+) MB", error.value.what)
    assert stated
    assert int(stated[1].replace(",", "")) > 8000 * 8000 * 11 * 4 / 2**20
    assert "16 Gaussians in 8000x8000 pixels" in error.value.where
    assert "raise the memory budget" in error.value.fix
    renderer.forward(block, view_of(100, 80))


def test_too_many_pairs_raise_and_the_next_render_is_correct(device: Device) -> None:
    """Case 5 in small: each Gaussian fills the image, the lists outgrow a small budget."""
    large, view = block_of(device, 3000, log_scale=6.0), view_of(500, 400)
    renderer = Renderer(device, memory_budget=12 * 2**20)
    small = block_of(device, 50)
    before = renderer.forward(small, view)[0].read("rgb").clone()
    for _ in range(2):
        with pytest.raises(MemoryBudgetError, match=r"more than .* pairs"):
            renderer.forward(large, view)
        assert torch.equal(renderer.forward(small, view)[0].read("rgb"), before)


def test_lists_grown_for_a_small_image_do_not_hide_the_limit_of_a_large_one(device: Device) -> None:
    """The limit of the larger image is below the existing capacity."""
    renderer = Renderer(device, memory_budget=40 * 2**20)
    small, wide = view_of(300, 200), view_of(900, 800)
    fills = block_of(device, 60 if device.variant == "cpu" else 9, log_scale=6.0)
    many = block_of(device, 4000 if device.variant == "cpu" else 900, log_scale=6.0)
    _, lease = renderer.forward(many, small)
    capacity, limit = lease.frame.arrays["pairs"].shape[0] // 2, lease.frame.pair_limit
    del lease
    _, lease = renderer.forward(fills, wide)
    assert lease.frame.pair_limit < capacity <= limit * 9 // 8
    with pytest.raises(MemoryBudgetError, match="more than"):
        renderer.forward(many, wide)


def test_more_than_2_to_the_32_pairs_raise_soon(device: Device) -> None:
    """Case 5: the count exceeds 32 bits. It must not overflow, nor take minutes of a processor."""
    renderer = Renderer(device)
    width, height = renderer.programs.tile
    tiles = 4096 // width * 4096 // height
    count = int(1.1 * 2**32 / tiles)
    block = block_of(device, count, log_scale=12.0)
    started = time.process_time()
    with pytest.raises(MemoryBudgetError, match=r"more than .* pairs") as error:
        renderer.forward(block, view_of(4096, 4096))
    assert time.process_time() - started < 60
    assert f"{count:,} Gaussians" in error.value.where


def test_an_image_beyond_any_index_raises(device: Device) -> None:
    renderer, block = Renderer(device), block_of(device, 16)
    for width, height in ((65536, 1), (1, 70000), (20000, 20000)):
        with pytest.raises(CameraError, match="too large"):
            renderer.forward(block, view_of(width, height))


def test_a_gaussian_in_the_last_of_very_many_tiles(device: Device) -> None:
    """Case 23: on a GPU more than 65,536 tiles; a CPU's are larger, so there a very wide image."""
    renderer = Renderer(device)
    tile_width, tile_height = renderer.programs.tile
    columns, rows = (900, 2) if device.variant == "cpu" else (300, 220)
    width, height = tile_width * columns + 1, tile_height * rows + 1
    camera = Camera(torch.eye(4), 1e5, 1e5, 0.0, 0.0, width, height)
    block = block_of(device, 1)
    values = block.parameters.read().clone()
    values[:3, 0] = torch.tensor([(width - 0.5) / 1e5, (height - 0.5) / 1e5, 1.0])
    values[3:6, 0], values[10, 0] = -20.0, 4.0
    block.parameters.write(values)
    alpha = renderer.forward(block, RenderRequest(camera, BLACK, 0))[0].read("alpha")
    assert alpha[-1, -1] > 0.9
    assert alpha.count_nonzero() == 4


def test_an_allocation_failure_is_explained(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise cl.RuntimeError("clCreateBuffer failed: OUT_OF_RESOURCES")

    monkeypatch.setattr(cl, "Buffer", fail)
    with pytest.raises(MemoryBudgetError, match="could not allocate") as error:
        DeviceArray(device.as_discrete(), (16,))
    assert "in total" in error.value.where


def test_host_memory_that_the_system_refuses_is_explained(device: Device) -> None:
    resource = pytest.importorskip("resource", reason="Windows cannot limit address space")
    if not Path("/proc/self/statm").exists():
        pytest.skip("only Linux tells the address space in use")
    before = resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + 2**27, before[1]))
    try:
        with pytest.raises(MemoryBudgetError, match="could not allocate 256 MB"):
            device.allocate(2**26, torch.float32, None)
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def test_a_buffer_larger_than_the_driver_allows_is_refused_with_numbers(device: Device) -> None:
    small = device.as_discrete()
    small.buffer_bytes = 2**20
    with pytest.raises(MemoryBudgetError, match="a buffer of 4 MB is too large") as error:
        DeviceArray(small, (2**20,))
    assert "at most 1 MB at once" in error.value.where
    assert "25% as many Gaussians" in error.value.fix
    with pytest.raises(MemoryBudgetError, match="is too large"):
        block_of(small, 20_000)  # 14 rows of 80 KB


def test_pairs_that_do_not_fit_into_one_buffer_are_refused(device: Device) -> None:
    view, small = view_of(500, 400), device.as_variant(device.variant)
    small.buffer_bytes = 3 * 2**20
    block = block_of(small, 3000, log_scale=6.0)
    with pytest.raises(MemoryBudgetError, match="at most 3 MB in one buffer"):
        Renderer(small).forward(block, view)
