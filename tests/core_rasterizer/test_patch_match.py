"""PatchMatch against a float64 twin of its costs, and on a wall whose planes are known."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
import torch
from torch import Tensor

from core_rasterizer import Camera, Device
from core_rasterizer.matching import MOST_PATCH_SOURCES, PatchMatch, PlaneMap
from core_rasterizer.matching.patch_level import PatchLevel

from . import patch_match_oracle as oracle
from .test_plane_sweep import pose, textures, uneven_cameras

RADIUS = 3
BOUNDS = (2.0, 8.0)
OTHERS = [[1, 2], [0, 2], [0, 1]]
NORMAL = torch.tensor([0.5, -0.2, -0.84], dtype=torch.float64)
"""Of a wall through (0, 0, 4), which the first camera sees at 33 degrees from its normal."""


def wall() -> tuple[list[Tensor], list[Camera], list[Tensor]]:
    """Images `[H, W]`, cameras, and depths of a wall with a pattern, from up to 28 degrees apart."""
    poses = [pose(0, 0, 0, 0, 0), pose(1.0, 0.1, 0.1, -0.25, 0), pose(-1.0, -0.2, 0, 0.25, 0.05)]
    cameras = [Camera.centered(matrix, 70, 64, 48) for matrix in poses]
    images, depths = [], []
    for camera in cameras:
        u, v = camera.pixel_centers()
        rays = camera.unproject(u, v, torch.ones_like(u)) - camera.center
        start = torch.tensor([0.0, 0.0, 4.0], dtype=torch.float64) - camera.center
        depth = (start @ NORMAL) / (rays @ NORMAL)
        x, y, _ = (camera.center + depth[..., None] * rays).unbind(-1)
        waves = (3.1, 0.7), (-1.3, 4.1), (7.3, 5.2), (-9.1, 8.3), (2.2, -11.7)
        pattern = sum(torch.sin(a * x + b * y + a) for a, b in waves)
        images.append((0.5 + 0.1 * torch.as_tensor(pattern)).float())
        depths.append(depth)
    return images, cameras, depths


def match(device: Device, images: list[Tensor], cameras: list[Camera]) -> list[PlaneMap]:
    return PatchMatch(device, images, cameras, BOUNDS).maps(OTHERS)


def test_costs_agree_with_the_twin(device: Device) -> None:
    cameras = uneven_cameras()
    images = textures(cameras)
    generator = torch.Generator().manual_seed(1)
    size = (cameras[0].height, cameras[0].width)
    nearness = 0.1 + 0.8 * torch.rand(size, generator=generator)
    steps = 0.02 * torch.randn(2, *size, generator=generator)
    level = PatchLevel(device, images, cameras, (0.1, 0.9), radius=RADIUS, seed=0)
    level.planes[0].write(torch.cat([nearness[None], steps, torch.zeros(1, *size)]))
    costs = level.costs(0, [1, 2, 3])
    expected, unsure = oracle.costs(
        [image.double().numpy() for image in images],
        cameras,
        torch.cat([nearness[None], steps]).double().numpy(),
        RADIUS,
    )
    known = torch.from_numpy(expected)
    error = (costs - known).abs()[~torch.from_numpy(unsure)]
    assert error.max() < 5e-3
    assert (known == 2).any()
    assert (known < 0.9).any()


def test_a_slanted_wall_is_recovered(device: Device) -> None:
    images, cameras, depths = wall()
    for found, camera, depth in zip(match(device, images, cameras), cameras, depths, strict=True):
        error = ((found.depth - depth).abs() / depth)[4:-4, 12:-12]
        assert (error < 0.01).float().mean() > 0.9
        assert (error < 0.03).float().mean() > 0.97
        towards = camera.world_to_camera[:3, :3] @ NORMAL
        turned = (found.normal.double() @ towards)[4:-4, 12:-12] / NORMAL.norm()
        assert (turned > 0.96).float().mean() > 0.85
        torch.testing.assert_close(found.normal.norm(dim=-1), torch.ones(48, 64))
        assert found.cost[4:-4, 12:-12].median() < 0.05


def test_two_runs_give_the_same_bits_and_another_seed_gives_others(device: Device) -> None:
    images, cameras, _ = wall()
    first, second = (PatchMatch(device, images, cameras, BOUNDS).maps(OTHERS) for _ in range(2))
    for one, other in zip(first, second, strict=True):
        assert torch.equal(one.depth, other.depth)
        assert torch.equal(one.normal, other.normal)
        assert torch.equal(one.cost, other.cost)
    other_seed = PatchMatch(device, images, cameras, BOUNDS, seed=1).maps(OTHERS)
    assert not torch.equal(other_seed[0].depth, first[0].depth)


def digest() -> str:
    """What the default device finds, for a process of its own."""
    from hashlib import sha256

    from core_rasterizer import open_device

    images, cameras, _ = wall()
    found = match(open_device("portable"), images, cameras)
    return sha256(b"".join(one.depth.numpy().tobytes() for one in found)).hexdigest()


@pytest.mark.parametrize("threads", ["1", "2"])
def test_the_number_of_threads_changes_no_bit(threads: str) -> None:
    code = "from tests.core_rasterizer import test_patch_match; print(test_patch_match.digest())"
    environment = os.environ | {"POCL_MAX_PTHREAD_COUNT": threads, "POCL_CPU_MAX_CU_COUNT": threads}
    process = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment
    )
    assert process.stdout.strip() == digest()


def test_flat_images_and_values_that_are_no_numbers_are_harmless(device: Device) -> None:
    images, cameras, _ = wall()
    flat = torch.full_like(images[0], 0.4)
    broken = torch.full_like(images[0], float("nan"))
    for found in match(device, [flat, broken, images[2]], cameras):
        assert torch.isfinite(found.depth).all()
        assert torch.isfinite(found.normal).all()
        assert ((found.depth > 0.99 * BOUNDS[0]) & (found.depth < 1.01 * BOUNDS[1])).all()
        assert found.cost.median() > 0.7


@pytest.mark.parametrize("size", [(1, 1), (1, 40), (40, 1), (3, 2)])
def test_tiny_images_are_no_exception(device: Device, size: tuple[int, int]) -> None:
    width, height = size
    cameras = [Camera.centered(pose(x, 0, 0, 0, 0), 40, width, height) for x in (0.0, 0.4)]
    images = [torch.rand(height, width, generator=torch.Generator().manual_seed(2))] * 2
    for found in PatchMatch(device, images, cameras, BOUNDS).maps([[1], [0]]):
        assert found.depth.shape == (height, width)
        assert torch.isfinite(found.depth).all()
        assert torch.isfinite(found.cost).all()


def test_wrong_arguments_are_refused(device: Device) -> None:
    images, cameras, _ = wall()
    with pytest.raises(ValueError, match="has a camera of 64x48"):
        PatchMatch(device, [images[0], images[1][1:], images[2]], cameras, BOUNDS)
    with pytest.raises(ValueError, match="0 < near < far"):
        PatchMatch(device, images, cameras, (2.0, 2.0))
    with pytest.raises(ValueError, match="0 < near < far"):
        PatchMatch(device, images, cameras, (2.0, float("inf")))
    with pytest.raises(ValueError, match="view 1 has 0 source views"):
        PatchMatch(device, images, cameras, BOUNDS).maps([[1], [], [1]])
    with pytest.raises(ValueError, match=f"1 to {MOST_PATCH_SOURCES} are allowed"):
        PatchMatch(device, images, cameras, BOUNDS).maps([[1] * 13, [0], [0]])
