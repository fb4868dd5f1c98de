"""No kernel reads or writes outside its buffers."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import pytest
import torch
from torch import Tensor

from core_rasterizer import (
    Adam,
    Camera,
    Device,
    Edit,
    GaussianModel,
    Gaussians,
    Relocation,
    apply_edit,
    photometric_loss,
    rasterize,
)
from core_rasterizer.device import DeviceArray
from core_rasterizer.raster import Renderer, RenderRequest, renderer
from tests.core_rasterizer.guarded import PATTERNS, GuardedDevice
from tests.core_rasterizer.options import all_options, posed
from tests.core_rasterizer.quick_device import QuickDevice
from tests.core_rasterizer.scenes import (
    Leaves,
    fresh,
    gradient,
    parameters,
    random_camera,
    random_scene,
    rates,
    weighted_loss,
)

RATES = rates(1e-3)


@pytest.fixture(scope="module")
def device(device: QuickDevice) -> Device:
    """Many variants of the kernels are built here."""
    return device.unoptimized


@cache
def guarded(device: Device, pattern: int) -> GuardedDevice:
    return GuardedDevice(device, pattern)


def same_inside_zones(device: Device, work: Callable[[Device], list[Tensor]]) -> None:
    """Check that zones stay untouched and that their contents do not affect the results."""
    expected = work(device)
    assert all(torch.isfinite(values).all() for values in expected)
    for pattern in PATTERNS:
        inside = guarded(device, pattern)
        results = work(inside)
        for number, (values, truth) in enumerate(zip(results, expected, strict=True)):
            assert torch.equal(values, truth), f"result {number} depends on memory outside buffers"
        assert inside.check() > 0


def rendered(scene: Leaves, camera: Camera, device: Device, **options: Any) -> list[Tensor]:
    """Images and gradients of one render."""
    leaves = fresh(scene)
    rendering = rasterize(*leaves, camera, (0.1, 0.2, 0.3), **options, device=device)
    weighted_loss(rendering, 0).backward()
    images = [rendering.rgb, rendering.depth, rendering.alpha]
    return [image.detach().clone() for image in images] + [gradient(leaf) for leaf in leaves]


@pytest.mark.parametrize("pattern", PATTERNS)
def test_the_zones_catch_writes_outside_a_buffer(device: Device, pattern: int) -> None:
    """The test itself: a kernel gets a length one element too large."""
    inside = GuardedDevice(device, pattern)
    array = DeviceArray(inside, (15,), torch.int32)
    totals = DeviceArray(inside, (17,), torch.int32)
    program = inside.program("raster/scan", dtype=torch.float32, SCAN_GROUP=16, SCAN_ITEMS=1)
    arrays = {"counts": array, "totals": totals}
    program.run("scan_chunks", (16,), (16,), **arrays, buckets=15, chunks=1)
    assert inside.check() == 2
    program.run("scan_chunks", (16,), (16,), **arrays, buckets=16, chunks=1)
    assert totals.read()[15] == torch.tensor([pattern] * 4, dtype=torch.uint8).view(torch.int32)
    with pytest.raises(AssertionError, match="after buffer 0"):
        inside.check()


@pytest.mark.parametrize("count", [0, 1, 15, 16, 17])
@pytest.mark.parametrize("size", [(1, 1), (65, 33)], ids=lambda size: f"{size[0]}x{size[1]}")
def test_any_count_and_any_image_size(device: Device, count: int, size: tuple[int, int]) -> None:
    generator = torch.Generator().manual_seed(count)
    scene, camera = random_scene(generator, count), random_camera(generator, *size)
    tensors = scene.tensors(torch.float32)
    same_inside_zones(device, lambda on: rendered(tensors, camera, on))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("count", [0, 1, 8, 17, 2100])
def test_poses_and_filters(device: Device, count: int, dtype: torch.dtype) -> None:
    """Fewer and more blocks of Gaussians than there are chunks of the pose's sum."""
    generator = torch.Generator().manual_seed(count)
    scene, camera = random_scene(generator, count), random_camera(generator, 65, 33)
    options = all_options(generator, count)
    tensors = scene.tensors(dtype)

    def work(on: Device) -> list[Tensor]:
        with_pose, pose = posed(camera)
        return [*rendered(tensors, with_pose, on, **options), gradient(pose)]

    same_inside_zones(device, work)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("scale", [1e-12, 3.0, 1e6, 1e17])
def test_small_and_huge_gaussians_at_tile_edges(
    device: Device, dtype: torch.dtype, scale: float
) -> None:
    """Means on, and one rounding step from, the edges of the image and of tiles."""
    edges = torch.tensor([-0.5, 0.0, 0.5, 15.5, 16.0, 32.0, 63.5, 64.0, 95.0, 96.5, 97.0])
    x, y = (values.flatten() for values in torch.meshgrid(edges, edges, indexing="ij"))
    count = len(x)
    camera = Camera(torch.eye(4), 100.0, 100.0, 0.0, 0.0, 97, 65)
    generator = torch.Generator().manual_seed(0)
    scene = random_scene(generator, count, sh_degree=1)
    scene.means = torch.stack((x / 100, y / 100, torch.ones(count)), dim=1).double() * 2
    scene.scales = torch.full((count, 3), scale, dtype=torch.float64)
    scene.scales[::3, 0] = 1e-6  # needles and discs
    tensors = scene.tensors(dtype)
    same_inside_zones(device, lambda on: rendered(tensors, camera, on))


def test_the_list_of_pairs_overflows_and_grows(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    """More pairs than the initial capacity; then a small render in the large buffers."""
    first = 1 << 11
    monkeypatch.setattr(renderer, "PAIRS_AT_FIRST", first)
    device = device.as_variant(device.variant)  # its lists have not grown
    generator = torch.Generator().manual_seed(1)
    width, height = 300, 200
    tile_width, tile_height = Renderer(device).programs.tile
    count = int(1.3 * first / (-(-width // tile_width) * -(-height // tile_height)))
    large, small = random_scene(generator, count, sh_degree=0), random_scene(generator, 5)
    large.scales[:] = 40.0
    large.opacities[:] = 0.005
    wide = random_camera(generator, width, height)
    gaussians = Gaussians(
        large.means, large.scales.log(), large.quaternions, torch.logit(large.opacities), large.sh
    )
    model = GaussianModel(gaussians, device)
    lease = model.renderer.forward(model.block, RenderRequest(wide, (0.0, 0.0, 0.0), 0))[-1]
    assert lease.frame.pairs > first
    tensors = large.tensors(torch.float32), small.tensors(torch.float32)

    def work(on: Device) -> list[Tensor]:
        results = rendered(tensors[0], wide, on)
        return results + rendered(tensors[1], random_camera(generator.manual_seed(2)), on)

    same_inside_zones(device, work)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(
    "size",
    [(1, 1), (1, 40), (40, 1), (2, 3), (3, 3), (11, 11), (17, 33)],
    ids=lambda size: f"{size[0]}x{size[1]}",
)
def test_the_photometric_loss(device: Device, size: tuple[int, int], dtype: torch.dtype) -> None:
    generator = torch.Generator().manual_seed(3)
    images = torch.rand(2, *size, 3, generator=generator, dtype=dtype)

    def work(on: Device) -> list[Tensor]:
        rgb = images[0].clone().requires_grad_()
        loss = photometric_loss(rgb, images[1], device=on)
        loss.backward()
        return [loss.detach(), gradient(rgb)]

    same_inside_zones(device, work)


@pytest.mark.parametrize(("count", "degree"), [(1, 3), (16, 0), (17, 3), (4097, 0)])
def test_adam_and_topology(device: Device, count: int, degree: int) -> None:
    """Steps at lower bands too, moments reset; clones, splits, prunes, relocated and added ones."""
    gaussians = parameters(count, sh_degree=degree)
    camera = random_camera(torch.Generator().manual_seed(4), 15, 11)

    def work(on: Device) -> list[Tensor]:
        generator = torch.Generator().manual_seed(5)
        model = GaussianModel(gaussians, on)
        optimizer = Adam(model)
        for active in (0, degree):
            model.zero_gradients()
            rgb = model.render(
                camera, sh_degree=active, collect_statistics=True, collect_absolute=True
            ).rgb
            rgb.sum().backward()
            optimizer.step(RATES, active_sh_degree=active)
        statistics = model.statistics.sums()
        optimizer.reset_moments("opacity_logits")
        model.write("opacity_logits", model.opacities() - 1)
        masks = torch.rand(3, count, generator=generator) < torch.tensor([[0.5], [0.5], [0.3]])
        masks[2, 0] = False
        apply_edit(model, optimizer, Edit(*masks), generator)
        first = torch.zeros(model.count // 3, dtype=torch.int64)
        edit = Edit(
            split=torch.arange(model.count) == model.count - 1,
            split_into=3,
            add=gaussians,
            parents=torch.zeros(count, dtype=torch.int64),
            relocate=Relocation(first, 1 + torch.arange(len(first))),
        )
        apply_edit(model, optimizer, edit, generator)
        rendering = model.render(
            camera, opacity_scale=torch.ones(model.count), detach=("means", "sh")
        )
        (rendering.depth.sum() + model.parameter("scales").sum()).backward()
        optimizer.step(RATES, active_sh_degree=degree, skip=("sh_rest",))
        state = optimizer.state()
        after = [model.read(name).clone() for name in ("means", "log_scales", "sh")]
        return [
            *after,
            rendering.visible,
            statistics,
            state["first_moments"],
            state["second_moments"],
        ]

    same_inside_zones(device, work)
