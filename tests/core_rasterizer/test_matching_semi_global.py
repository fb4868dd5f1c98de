"""Semi-global aggregation against a plain twin: exact on every device and variant."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings, strategies as st

from core_rasterizer import Device, MemoryBudgetError, open_device
from core_rasterizer.device import DeviceArray
from core_rasterizer.matching import MAX_PENALTY, Penalties, aggregate, pick
from core_rasterizer.matching.semi_global import empty_volume, padded_planes
from tests.core_rasterizer import matching_oracle as oracle

SHAPES = [(7, 11, 16), (11, 7, 32), (1, 5, 16), (9, 1, 16), (1, 1, 48), (12, 21, 48)]
PENALTIES = [Penalties(10, 250), Penalties(0, 0), Penalties(80, MAX_PENALTY)]


def volume(device: Device, values: oracle.Ints) -> DeviceArray:
    costs = DeviceArray(device, values.shape, torch.uint8)
    costs.write(torch.from_numpy(values))
    return costs


def random_case(shape: tuple[int, int, int], seed: int) -> tuple[oracle.Ints, oracle.Ints]:
    """Costs, and a grey image with both flat places and edges."""
    generator = np.random.default_rng(seed)
    costs = generator.integers(0, 256, shape)
    grey = np.maximum(0, generator.integers(-60, 256, shape[:2])) // 4
    return costs, grey


def summed(
    device: Device, costs: oracle.Ints, grey: oracle.Ints, penalties: Penalties
) -> oracle.Ints:
    sums = aggregate(device, volume(device, costs), torch.from_numpy(grey) / 255, penalties)
    return sums.read().to(torch.int64).numpy()


@pytest.mark.parametrize("penalties", PENALTIES, ids=str)
@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_sums_equal_the_twins(
    device: Device, shape: tuple[int, int, int], penalties: Penalties
) -> None:
    costs, grey = random_case(shape, 0)
    expected = oracle.aggregate(costs, grey, penalties)
    assert np.array_equal(summed(device, costs, grey, penalties), expected)
    assert np.array_equal(summed(device.as_discrete(), costs, grey, penalties), expected)


@settings(max_examples=25)
@given(
    height=st.integers(1, 12),
    width=st.integers(1, 20),
    blocks=st.integers(1, 2),
    small=st.integers(0, 300),
    extra=st.integers(0, 6000),
    seed=st.integers(0, 10**6),
)
def test_sums_equal_the_twins_on_any_shape(
    height: int, width: int, blocks: int, small: int, extra: int, seed: int
) -> None:
    costs, grey = random_case((height, width, 16 * blocks), seed)
    penalties = Penalties(small, small + extra)
    expected = oracle.aggregate(costs, grey, penalties)
    assert np.array_equal(summed(open_device(), costs, grey, penalties), expected)


def test_the_largest_sums_do_not_overflow(device: Device) -> None:
    costs = np.full((20, 20, 16), 255)
    costs[::2, ::2, 0] = 0
    costs[1::2, ::2, 15] = 0
    penalties = Penalties(MAX_PENALTY, MAX_PENALTY)
    grey = np.zeros((20, 20), dtype=np.int64)
    expected = oracle.aggregate(costs, grey, penalties)
    assert np.array_equal(summed(device, costs, grey, penalties), expected)


@pytest.mark.parametrize("planes", [1, 2, 3, 16, 21, 47, 48])
def test_the_cheapest_plane_is_the_twins(device: Device, planes: int) -> None:
    sums = np.random.default_rng(planes).integers(0, 40, (6, 9, 48)) ** 2
    sums[:, 0] = 700
    array = DeviceArray(device, sums.shape, torch.uint16)
    array.write(torch.from_numpy(sums))
    index, confidence = pick(device, array, planes)
    expected_index, expected_confidence = oracle.cheapest(sums, planes)
    assert np.allclose(index, expected_index, atol=1e-5)
    assert np.allclose(confidence, expected_confidence, atol=1e-6)


def test_a_fraction_of_a_plane_is_found(device: Device) -> None:
    true = torch.linspace(3, 11, 60).reshape(5, 12)
    costs = (15 * (torch.arange(16) - true[..., None]).abs()).round().clamp(max=255)
    array = volume(device, costs.to(torch.int64).numpy())
    sums = aggregate(device, array, torch.rand(5, 12), Penalties(0, 0))
    assert torch.allclose(pick(device, sums, 16)[0], true, atol=0.06)


def test_jumps_are_cheaper_at_edges() -> None:
    steps = Penalties(10, 250).by_grey_step()
    assert steps[[0, 1, 2, 10, 25, 26, 255]].tolist() == [250, 250, 125, 25, 10, 10, 10]


@pytest.mark.parametrize("wrong", [(-1, 5), (6, 5), (5, MAX_PENALTY + 1)])
def test_penalties_out_of_order_raise(wrong: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match="0 <= small <= large"):
        Penalties(*wrong)


def test_invalid_volumes_raise() -> None:
    device = open_device()
    costs = np.zeros((4, 5, 16), dtype=np.int64)
    with pytest.raises(ValueError, match="do not match the image"):
        aggregate(device, volume(device, costs), torch.zeros(5, 4), Penalties(1, 2))
    with pytest.raises(ValueError, match="do not match the image"):
        aggregate(device, volume(device, costs[..., :9]), torch.zeros(4, 5), Penalties(1, 2))
    sums = DeviceArray(device, (4, 5, 16), torch.uint16)
    for planes in (0, 17):
        with pytest.raises(ValueError, match="it must lie in 1"):
            pick(device, sums, planes)


def test_a_volume_beyond_the_memory_raises() -> None:
    device = open_device()
    assert empty_volume(device, 3, 4, 17).shape == (3, 4, padded_planes(17)) == (3, 4, 32)
    with pytest.raises(MemoryBudgetError, match="1000 planes of 100000x100000 pixels"):
        empty_volume(device, 100_000, 100_000, 1000)
