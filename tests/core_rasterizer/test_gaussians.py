"""The search for values that are not finite."""

from __future__ import annotations

import math

import pytest
import torch

from core_rasterizer.gaussians import undefined_places


def test_finds_every_place_in_order() -> None:
    values = torch.zeros(3, 4)
    values[0, 3], values[2, 1], values[1, 0] = math.nan, math.inf, -math.inf
    assert undefined_places(values).tolist() == [[0, 3], [1, 0], [2, 1]]


def test_an_overflowing_sum_is_not_reported() -> None:
    assert undefined_places(torch.full((4,), 3e38)).shape == (0, 1)


@pytest.mark.parametrize("values", [torch.zeros(()), torch.zeros(0), torch.ones(2, 0, 3)])
def test_small_and_empty_tensors(values: torch.Tensor) -> None:
    assert undefined_places(values).shape == (0, values.ndim)


def test_a_single_number() -> None:
    assert undefined_places(torch.tensor(math.nan, requires_grad=True)).shape == (1, 0)
