"""The sweeps against their float64 twins, and on views whose depth is known."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch
from torch import Tensor

from core_rasterizer import Camera, Device, MemoryBudgetError
from core_rasterizer.matching import (
    MAX_SWEEP_RADIUS,
    FeatureSweep,
    Penalties,
    ZnccSweep,
    aggregate,
    pick,
    seen_by_any,
)
from tests.core_rasterizer import plane_sweep_oracle as oracle

SIZES = [(37, 29), (45, 31), (24, 40), (30, 30)]
INVERSE_DEPTHS = torch.linspace(0.1, 0.9, 19, dtype=torch.float64)


def pose(x: float, y: float, z: float, turn: float, tilt: float) -> Tensor:
    """World to camera: at (x, y, z), turned about the y axis and then tilted, radians."""
    a, b = math.cos(turn), math.sin(turn)
    c, d = math.cos(tilt), math.sin(tilt)
    turned = torch.tensor([[a, 0, -b], [0, 1, 0], [b, 0, a]], dtype=torch.float64)
    tilted = torch.tensor([[1, 0, 0], [0, c, -d], [0, d, c]], dtype=torch.float64)
    matrix = torch.eye(4, dtype=torch.float64)
    matrix[:3, :3] = tilted @ turned
    matrix[:3, 3] = -matrix[:3, :3] @ torch.tensor([x, y, z], dtype=torch.float64)
    return matrix


def uneven_cameras() -> list[Camera]:
    """Four sizes, focal lengths and principal points; the third looks past part of the scene and the
    last stands so far ahead that near planes lie behind it."""
    poses = [
        pose(0, 0, 0, 0, 0),
        pose(0.5, 0.1, -0.1, 0.1, 0.05),
        pose(-0.7, 0.2, 0.1, 0.5, -0.1),
        pose(0.1, -0.2, 2.5, -0.1, 0.1),
    ]
    return [
        Camera(
            matrix,
            30.0 + 4 * k,
            33.0 - 2 * k,
            width * (0.4 + 0.1 * k),
            height * 0.55,
            width,
            height,
        )
        for k, (matrix, (width, height)) in enumerate(zip(poses, SIZES, strict=True))
    ]


def textures(cameras: list[Camera]) -> list[Tensor]:
    """Coarse noise, `[H, W]` in [0, 1]."""
    generator = torch.Generator().manual_seed(5)
    images = []
    for camera in cameras:
        noise = torch.rand(1, 1, camera.height // 2, camera.width // 2, generator=generator)
        size = (camera.height, camera.width)
        images.append(torch.nn.functional.interpolate(noise, size, mode="bilinear")[0, 0])
    return images


@pytest.mark.parametrize(("radius", "count"), [(2, 2), (1, 3), (2, 4), (MAX_SWEEP_RADIUS, 3)])
def test_zncc_costs_agree_with_the_twin(device: Device, radius: int, count: int) -> None:
    cameras = uneven_cameras()[:count]
    images = textures(cameras)
    settings: dict[str, Any] = {"radius": radius, "noise": 0.01, "second_share": 0.25}
    sweep = ZnccSweep(device, images, cameras, INVERSE_DEPTHS, **settings)
    costs = sweep.costs(0, range(1, count)).read()
    expected = oracle.zncc_costs(
        [image.double().numpy() for image in images], cameras, INVERSE_DEPTHS.tolist(), **settings
    )
    assert costs.shape == (*images[0].shape, 32)
    assert (costs[..., 19:] == 255).all()
    known = torch.from_numpy(expected)
    # Pixels on the very border of a source view may fall on either side of it.
    error = (costs[..., :19].double() - known).abs()
    assert (error <= 1).float().mean() > 0.9995
    assert (known == oracle.UNKNOWN).any()
    assert (known != oracle.UNKNOWN).any()


@pytest.mark.parametrize("channels", [1, 8, 19])
def test_feature_costs_agree_with_the_twin(device: Device, channels: int) -> None:
    cameras = uneven_cameras()
    generator = torch.Generator().manual_seed(2)
    features = [
        torch.nn.functional.normalize(
            torch.randn(channels, camera.height, camera.width, generator=generator), dim=0
        )
        for camera in cameras
    ]
    sweep = FeatureSweep(device, features, cameras, INVERSE_DEPTHS, second_share=0.4)
    costs = sweep.costs(0, [1, 2, 3]).read()
    expected = oracle.feature_costs(
        [values.permute(1, 2, 0).double().numpy() for values in features],
        cameras,
        INVERSE_DEPTHS.tolist(),
        second_share=0.4,
    )
    assert (costs[..., 19:] == 255).all()
    error = (costs[..., :19].double() - torch.from_numpy(expected)).abs()
    assert (error <= 1).float().mean() > 0.9995


def test_kinds_of_devices_give_the_same_bits(device: Device) -> None:
    cameras = uneven_cameras()
    images = textures(cameras)
    volumes = []
    others = [device.as_variant("cpu")] if device.kind == "cpu" else []
    for one in (device, device, device.as_discrete(), *others):
        sweep = ZnccSweep(one, images, cameras, INVERSE_DEPTHS)
        volumes.append([sweep.costs(k, [j for j in range(4) if j != k]).read() for k in range(4)])
    for volume in volumes[1:]:
        assert all(torch.equal(a, b) for a, b in zip(volume, volumes[0], strict=True))


@pytest.mark.parametrize("lanes", [8, 16])
def test_processors_of_any_width_give_the_same_bits(
    device: Device, monkeypatch: pytest.MonkeyPatch, lanes: int
) -> None:
    """A processor takes as many lanes as it has registers for; here each takes both numbers."""
    if device.variant == "gpu":
        pytest.skip("GPUs take one lane")
    cameras = uneven_cameras()
    images, cpu = textures(cameras), device.as_variant("cpu")
    expected = ZnccSweep(cpu, images, cameras, INVERSE_DEPTHS).costs(0, [1, 2, 3]).read()
    program = cpu.program
    monkeypatch.setattr(
        cpu, "program", lambda *files, **options: program(*files, **{**options, "LANES": lanes})
    )
    costs = ZnccSweep(cpu, images, cameras, INVERSE_DEPTHS).costs(0, [1, 2, 3]).read()
    assert torch.equal(costs, expected)


def test_a_plane_is_recovered(device: Device) -> None:
    """A textured wall parallel to the images, seen by two cameras off their images' centres."""
    depth, focal = 4.0, 100.0
    generator = torch.Generator().manual_seed(0)
    noise = torch.rand(1, 1, 40, 60, generator=generator)
    wall = torch.nn.functional.interpolate(noise, (120, 180), mode="bicubic")[0, 0].clamp(0, 1)
    baseline = 8 * depth / focal  # 8 pixels, so that the second image is an exact crop
    here = Camera(torch.eye(4), focal, focal, 30, 50, 96, 64)
    there = Camera(here.shifted_right(baseline).world_to_camera, focal, focal, 43, 38, 100, 80)
    images = [wall[20:84, 20:116], wall[32:112, 15:115]]
    inverse_depths = torch.linspace(1 / 8, 1 / 2, 64, dtype=torch.float64)
    sweep = ZnccSweep(device, images, [here, there], inverse_depths)
    sums = aggregate(device, sweep.costs(0, [1]), images[0], Penalties(10, 500))
    plane, confidence = pick(device, sums, 64)
    found = 1 / (inverse_depths[0] + plane.double() * (inverse_depths[1] - inverse_depths[0]))
    assert seen_by_any(found, here, [there]).float().mean() > 0.7
    error = ((found - depth).abs() / depth)[16:-4, 12:-12]
    assert error.max() < 0.02
    assert error.mean() < 1e-3
    assert confidence.mean() > 0.3


def test_seen_is_what_projects_into_a_source() -> None:
    cameras = uneven_cameras()
    depth = torch.full((cameras[0].height, cameras[0].width), 3.0, dtype=torch.float64)
    inside = [oracle.landing(cameras[0], there, 3.0)[2] for there in cameras[1:3]]
    assert torch.equal(
        seen_by_any(depth, cameras[0], cameras[1:3]), torch.from_numpy(inside[0] | inside[1])
    )


def test_flat_images_match_nothing(device: Device) -> None:
    cameras = uneven_cameras()[:2]
    images = [torch.full((camera.height, camera.width), 0.4) for camera in cameras]
    costs = ZnccSweep(device, images, cameras, INVERSE_DEPTHS).costs(0, [1]).read()
    assert (costs[..., :19] == 128).all()


def test_views_that_do_not_overlap_leave_every_cost_unknown(device: Device) -> None:
    here = uneven_cameras()[0]
    behind = Camera(pose(0, 0, 0, math.pi, 0), 30, 30, 18, 15, 36, 30)
    sweep = ZnccSweep(device, textures([here, behind]), [here, behind], INVERSE_DEPTHS)
    assert (sweep.costs(0, [1]).read()[..., :19] == 128).all()
    assert not seen_by_any(torch.ones(here.height, here.width), here, [behind]).any()


def test_an_image_of_one_pixel(device: Device) -> None:
    cameras = [Camera(torch.eye(4), 1, 1, 0.5, 0.5, 1, 1), uneven_cameras()[1]]
    images = [torch.full((1, 1), 0.7), textures(cameras[1:])[0]]
    sweep = ZnccSweep(device, images, cameras, INVERSE_DEPTHS)
    assert sweep.costs(0, [1]).read().shape == (1, 1, 32)
    # A single source pixel has no texture: wherever it is seen or not, there is no evidence.
    assert (sweep.costs(1, [0]).read()[..., :19] == 128).all()


def test_invalid_arguments_raise(device: Device) -> None:
    cameras = uneven_cameras()[:2]
    images = textures(cameras)
    with pytest.raises(ValueError, match="has a camera of 37x29"):
        ZnccSweep(device, images[::-1], cameras, INVERSE_DEPTHS)
    with pytest.raises(ValueError, match="radius is 9"):
        ZnccSweep(device, images, cameras, INVERSE_DEPTHS, radius=9)
    with pytest.raises(ValueError, match="noise is 0"):
        ZnccSweep(device, images, cameras, INVERSE_DEPTHS, noise=0)
    with pytest.raises(ValueError, match="needs at least one plane"):
        ZnccSweep(device, images, cameras, INVERSE_DEPTHS[:0])
    with pytest.raises(ValueError, match="needs at least one source"):
        ZnccSweep(device, images, cameras, INVERSE_DEPTHS).costs(0, [])
    features = [image.expand(3, -1, -1) for image in images]
    with pytest.raises(ValueError, match="has 3 channels"):
        FeatureSweep(device, [features[0], features[1][:2]], cameras, INVERSE_DEPTHS)
    with pytest.raises(ValueError, match="has 3 channels"):
        FeatureSweep(device, features[::-1], cameras, INVERSE_DEPTHS)


def test_a_volume_beyond_the_memory_raises(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    cameras = uneven_cameras()[:2]
    small = device.as_discrete()
    monkeypatch.setattr(small, "memory_bytes", 100_000)
    sweep = ZnccSweep(small, textures(cameras), cameras, INVERSE_DEPTHS)
    with pytest.raises(MemoryBudgetError, match="fewer planes"):
        sweep.costs(0, [1])
