"""Matching costs of rectified pairs against plain twins in float64."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from core_rasterizer import Device, open_device
from core_rasterizer.device import DeviceArray
from core_rasterizer.matching import (
    MAX_RADIUS,
    census_costs,
    feature_costs,
    right_costs,
    zncc_costs,
)
from tests.core_rasterizer import matching_oracle as oracle

SIZES = [(9, 31, 12), (1, 1, 1), (1, 40, 17), (70, 1, 5), (5, 8, 40), (131, 12, 16)]


def pair(height: int, width: int, seed: int = 0) -> tuple[Tensor, Tensor]:
    """Grey images in whole 255ths, the right one the left one moved by 3 with noise."""
    generator = torch.Generator().manual_seed(seed)
    left = torch.randint(0, 256, (height, width), generator=generator)
    right = left.roll(-3, 1) + torch.randint(-20, 21, (height, width), generator=generator)
    return left / 255, right.clamp(0, 255) / 255


def numbers(costs: DeviceArray) -> oracle.Ints:
    return costs.read().to(torch.int64).numpy()


def assert_costs(costs: DeviceArray, expected: oracle.Ints, tolerance: int) -> None:
    found, planes = numbers(costs), expected.shape[2]
    assert found.shape[2] % 16 == 0
    assert np.abs(found[..., :planes] - expected).max() <= tolerance
    assert (found[..., planes:] == 255).all()
    unseen = np.arange(planes) > np.arange(found.shape[1])[:, None]
    assert np.array_equal(found[..., :planes][:, unseen], expected[:, unseen])


@pytest.mark.parametrize("size", SIZES, ids=str)
@pytest.mark.parametrize("radius", [1, 3])
def test_zncc(device: Device, size: tuple[int, int, int], radius: int) -> None:
    left, right = pair(*size[:2])
    expected = oracle.zncc(left.double().numpy(), right.double().numpy(), size[2], radius)
    assert_costs(zncc_costs(device, left, right, size[2], radius), expected, 1)
    there = device.as_discrete()
    assert_costs(zncc_costs(there, left, right, size[2], radius), expected, 1)


def test_zncc_of_the_largest_windows(device: Device) -> None:
    left, right = pair(40, 50)
    expected = oracle.zncc(left.double().numpy(), right.double().numpy(), 20, MAX_RADIUS)
    assert_costs(zncc_costs(device, left, right, 20, MAX_RADIUS), expected, 1)


def test_zncc_of_little_contrast_on_a_bright_ground(device: Device) -> None:
    texture, _ = pair(20, 40)
    left = 0.95 + 0.04 * (texture * 255).round() / 255
    expected = oracle.zncc(left.double().numpy(), left.double().numpy(), 16, 2)
    found = numbers(zncc_costs(device, left, left, 16, 2))
    assert (found.argmin(-1) == 0).all()
    # Rounding to grey levels moves a cost by a few steps here.
    assert np.abs(found - expected).max() <= 8


@pytest.mark.parametrize("level", [0.0, 0.3, 1.0])
def test_windows_without_texture_have_zero_correlation(device: Device, level: float) -> None:
    flat, textured = torch.full((20, 40), level), pair(20, 40)[0]
    for left, right in ((flat, flat), (flat, textured), (textured, flat)):
        found = numbers(zncc_costs(device, left, right, 16, 3))
        assert set(np.unique(found[:, 16:])) <= {127, 128}


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_census(device: Device, size: tuple[int, int, int]) -> None:
    left, right = pair(*size[:2])
    expected = oracle.census(left.numpy(), right.numpy(), size[2])
    assert_costs(census_costs(device, left, right, size[2]), expected, 0)
    assert_costs(census_costs(device.as_discrete(), left, right, size[2]), expected, 0)


@pytest.mark.parametrize("size", SIZES, ids=str)
@pytest.mark.parametrize("channels", [1, 7])
def test_features(device: Device, size: tuple[int, int, int], channels: int) -> None:
    generator = torch.Generator().manual_seed(1)
    left, right = (torch.randn(channels, *size[:2], generator=generator) for _ in range(2))
    left, right = left / left.norm(dim=0), right / right.norm(dim=0)
    first, second = (f.permute(1, 2, 0).double().numpy() for f in (left, right))
    expected = oracle.features(first, second, size[2])
    assert_costs(feature_costs(device, left, right, size[2]), expected, 1)
    assert_costs(feature_costs(device.as_discrete(), left, right, size[2]), expected, 1)


def test_zero_features_have_zero_correlation(device: Device) -> None:
    left, right = torch.zeros(4, 5, 20), torch.ones(4, 5, 20) / 2
    assert set(np.unique(numbers(feature_costs(device, left, right, 16))[:, 15:])) == {128}


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_costs_of_the_right_image_are_those_of_the_mirrored_pair(
    device: Device, size: tuple[int, int, int]
) -> None:
    left, right = pair(*size[:2])
    found = numbers(right_costs(device, zncc_costs(device, left, right, size[2], 2)))
    mirrored = zncc_costs(device, right.flip(1), left.flip(1), size[2], 2)
    assert np.abs(found - numbers(mirrored)[:, ::-1]).max() <= 1


def test_invalid_pairs_raise() -> None:
    device, image = open_device(), torch.zeros(4, 5)
    for cost in (census_costs, lambda device, a, b, most: zncc_costs(device, a, b, most, 2)):
        with pytest.raises(ValueError, match="a pair has the shapes"):
            cost(device, image, torch.zeros(4, 6), 3)
        with pytest.raises(ValueError, match="a pair has the shapes"):
            cost(device, torch.zeros(0, 5), torch.zeros(0, 5), 3)
        with pytest.raises(ValueError, match="planes is 0"):
            cost(device, image, image, 0)
    with pytest.raises(ValueError, match="a pair has the shapes"):
        feature_costs(device, torch.zeros(3, 4, 5), torch.zeros(2, 4, 5), 3)
    for radius in (0, MAX_RADIUS + 1):
        with pytest.raises(ValueError, match="the radius is"):
            zncc_costs(device, image, image, 3, radius)
