"""The left-right check, on maps whose answers are known pixel by pixel."""

from __future__ import annotations

import torch
from torch import Tensor

from registry.priors import Disparity
from stereogs_plugins.regularizers.stereo_depth.left_right_check import agreeing
from tests.stereogs_plugins.building import build
from tests.stereogs_plugins.regularizers.stereo_depth.block_matching import (
    BlockMatcher,
    PrintedOrder,
    Wall,
)


def known(values: Tensor) -> Disparity:
    valid = torch.isfinite(values) & (values > 0)
    return Disparity(torch.where(valid, values, 0.0), valid)


def test_two_planes_hide_exactly_what_they_hide() -> None:
    """A card at disparity 10 in columns 30 to 39, before a wall at disparity 4."""
    left, right = torch.full((5, 80), 4.0), torch.full((5, 80), 4.0)
    left[:, 30:40] = 10
    right[:, 20:30] = 10  # the card, as the right camera sees it
    expected = torch.ones(5, 80, dtype=torch.bool)
    expected[:, :4] = False  # the wall there is left of the right image
    expected[:, 24:30] = False  # the wall there is behind the card for the right camera
    assert torch.equal(agreeing(known(left), known(right), 2.0), expected)
    assert torch.equal(agreeing(known(left), known(right), 6.0)[:, 4:], torch.ones(5, 76) > 0)


def test_between_two_pixels_the_right_disparity_is_interpolated() -> None:
    left = torch.full((1, 8), 2.25)
    right = torch.arange(8.0)[None] + 1
    # The partner's disparity at column u is u - 1.25: half a pixel off at 3 and 4.
    columns = (agreeing(known(left), known(right), 0.51)[0]).nonzero()[:, 0].tolist()
    assert columns == [3, 4]
    assert not agreeing(known(left), known(right), 0.49).any()


def test_what_is_unknown_or_outside_does_not_agree() -> None:
    left = torch.tensor([[1.0, 1.0, torch.nan, 1.0, -1.0, 1.0, 5.5, torch.inf]])
    right = torch.tensor([[1.0, 1.0, torch.nan, 1.0, 1.0, 1.0, 1.0, 1.0]])
    agree = agreeing(known(left), known(right), 2.0)[0].tolist()
    #        u=-1   ok    nan    right nan  < 0    ok    5.5 is wrong  inf
    assert agree == [False, True, False, False, False, True, False, False]


def test_a_fractional_partner_beside_an_unknown_one_does_not_agree() -> None:
    left = torch.full((1, 6), 0.5)
    right = torch.full((1, 6), 0.5)
    right[0, 2] = torch.nan
    assert agreeing(known(left), known(right), 1.0)[0].tolist() == [
        False,  # -0.5
        True,
        False,  # between 1 and 2
        False,  # between 2 and 3
        True,
        True,
    ]


def test_a_whole_disparity_beside_an_unknown_one_agrees() -> None:
    left, right = torch.ones(1, 6), torch.ones(1, 6)
    right[0, 2] = torch.nan
    agree = agreeing(known(left), known(right), 1.0)[0].tolist()
    assert agree == [False, True, True, False, True, True]


def test_the_right_order_of_images_agrees_and_the_printed_one_does_not() -> None:
    wall = Wall()
    right = wall.model.render(wall.view.camera.shifted_right(0.5)).rgb.detach().clamp(0, 1)
    agree = [
        agreeing(*build(matcher).both(wall.view.image, right), 2.0).float().mean()
        for matcher in (BlockMatcher, PrintedOrder)
    ]
    assert agree[0] > 0.8
    assert agree[1] < 0.2
