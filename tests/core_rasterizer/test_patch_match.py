"""PatchMatch against a float64 twin of its costs, and on a wall whose planes are known."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from core_rasterizer import Camera, Device
from core_rasterizer.matching import MAX_PATCH_SOURCES, PatchMatch
from core_rasterizer.matching.patch_level import PatchLevel
from core_rasterizer.matching.patch_match import PlaneMap
from tests.core_rasterizer import patch_match_oracle as oracle
from tests.core_rasterizer.slanted_wall import BOUNDS, NORMAL, OTHERS, wall
from tests.core_rasterizer.test_plane_sweep import pose, textures, uneven_cameras

RADIUS = 3


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


def test_another_seed_draws_other_planes(device: Device) -> None:
    """That one seed gives the same bits, with any number of threads, is in test_repeatability.py."""
    images, cameras, _ = wall()
    depths = [
        PatchMatch(device, images[:2], cameras[:2], BOUNDS, seed=seed).maps([[1], [0]])[0].depth
        for seed in (0, 0, 1)
    ]
    assert torch.equal(depths[0], depths[1])
    assert not torch.equal(depths[0], depths[2])


def test_flat_images_and_nan_are_harmless(device: Device) -> None:
    images, cameras, _ = wall()
    flat = torch.full_like(images[0], 0.4)
    broken = torch.full_like(images[0], float("nan"))
    for found in match(device, [flat, broken, images[2]], cameras):
        assert torch.isfinite(found.depth).all()
        assert torch.isfinite(found.normal).all()
        assert ((found.depth > 0.99 * BOUNDS[0]) & (found.depth < 1.01 * BOUNDS[1])).all()
        assert found.cost.median() > 0.7


@pytest.mark.parametrize("size", [(1, 1), (1, 40), (40, 1), (3, 2)])
def test_tiny_images(device: Device, size: tuple[int, int]) -> None:
    width, height = size
    cameras = [Camera.centered(pose(x, 0, 0, 0, 0), 40, width, height) for x in (0.0, 0.4)]
    images = [torch.rand(height, width, generator=torch.Generator().manual_seed(2))] * 2
    for found in PatchMatch(device, images, cameras, BOUNDS).maps([[1], [0]]):
        assert found.depth.shape == (height, width)
        assert torch.isfinite(found.depth).all()
        assert torch.isfinite(found.cost).all()


def test_invalid_arguments_raise(device: Device) -> None:
    images, cameras, _ = wall()
    with pytest.raises(ValueError, match="has a camera of 64x48"):
        PatchMatch(device, [images[0], images[1][1:], images[2]], cameras, BOUNDS)
    with pytest.raises(ValueError, match="0 < near < far"):
        PatchMatch(device, images, cameras, (2.0, 2.0))
    with pytest.raises(ValueError, match="0 < near < far"):
        PatchMatch(device, images, cameras, (2.0, float("inf")))
    with pytest.raises(ValueError, match="view 1 has 0 source views"):
        PatchMatch(device, images, cameras, BOUNDS).maps([[1], [], [1]])
    with pytest.raises(ValueError, match=f"1 to {MAX_PATCH_SOURCES} are allowed"):
        PatchMatch(device, images, cameras, BOUNDS).maps([[1] * 13, [0], [0]])
