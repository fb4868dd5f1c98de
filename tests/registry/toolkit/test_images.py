from __future__ import annotations

import math

import pytest
import torch

from registry.toolkit.images import at_size, dark_background, decibels, grey, predicted_psnr


def test_a_backdrop_is_dark_with_a_dark_run_to_its_left() -> None:
    image = torch.zeros(2, 120, 3)
    image[0, 30] = 0.5
    image[1, :, 1] = 30 / 255  # not below the level
    background = dark_background(image, 30)
    assert background[0, :30].all()
    assert not background[0, 30:81].any()
    assert background[0, 81:].all()
    assert not background[1].any()
    assert dark_background(image, 31)[1].all()


def test_a_backdrop_in_an_image_narrower_than_the_run() -> None:
    image = torch.zeros(1, 20, 3)
    image[0, 5] = 1
    assert dark_background(image, 30)[0].tolist() == [True] * 5 + [False] * 15


def test_grey_weighs_the_colors() -> None:
    colors = torch.tensor([[[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0.5, 0.5]]])
    torch.testing.assert_close(grey(colors), torch.tensor([[0.299, 0.587, 0.114, 0.5]]))


def test_a_map_at_a_renders_size_keeps_its_values() -> None:
    pixels = torch.arange(35.0).reshape(5, 7)
    assert at_size(pixels, 5, 7) is pixels
    # The middles of three rows and four columns fall into rows 0, 2, 4 and columns 0, 2, 4, 6.
    assert torch.equal(at_size(pixels, 3, 4), pixels[[0, 2, 4]][:, [0, 2, 4, 6]])
    assert torch.equal(at_size(pixels > 20, 1, 1), pixels[2:3, 3:4] > 20)
    pair = torch.stack([pixels, -pixels], dim=2)
    assert torch.equal(at_size(pair, 3, 4), pair[[0, 2, 4]][:, [0, 2, 4, 6]])


def test_a_psnr_has_a_limit_and_a_confidence_predicts_one() -> None:
    assert decibels(0.01) == pytest.approx(20)
    assert decibels(torch.tensor(0.0)) == 100
    # 1 - exp(-0.1 / m) = 1 - 1/e for a mean error m of 0.1, whose mean square is 0.02.
    even = torch.full((3, 4), 1 - math.exp(-1))
    assert predicted_psnr(even) == pytest.approx(-10 * math.log10(0.02), abs=1e-5)
