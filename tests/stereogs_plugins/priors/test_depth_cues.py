"""`depth_cues`: lower and sharper pixels are nearer."""

from __future__ import annotations

import pytest
import torch

from stereogs_plugins.priors.depth_cues import DepthCues, stereogs_register_priors
from tests.stereogs_plugins.building import build, offered


def test_registers_as_depth_cues() -> None:
    assert offered(stereogs_register_priors) == {"depth_cues": DepthCues}


def test_lower_pixels_are_nearer() -> None:
    answer = build(DepthCues, sharpness=0).inverse_depth(torch.full((40, 60, 3), 0.5))
    assert answer.shape == (40, 60)
    assert (answer.diff(dim=0) > 0).all()
    assert (answer.diff(dim=1) == 0).all()


def test_textured_pixels_are_nearer() -> None:
    image = torch.full((64, 96, 3), 0.5)
    image[:, 48:] += 0.3 * torch.rand(64, 48, 1, generator=torch.Generator().manual_seed(0))
    answer = build(DepthCues, sharpness=1).inverse_depth(image)
    assert answer[:, 56:].min() > answer[:, :40].max()


@pytest.mark.parametrize("size", [(1, 1), (3, 200), (37, 53)])
def test_any_size_gives_finite_ranks(size: tuple[int, int]) -> None:
    answer = build(DepthCues).inverse_depth(torch.rand(*size, 3))
    assert answer.shape == size
    assert answer.isfinite().all()
    assert answer.min() >= 0
    assert answer.max() <= 1
