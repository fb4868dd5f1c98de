"""DTU's backdrop, on images with a known answer per pixel."""

from __future__ import annotations

import torch

from registry.toolkit.photos import dark_background


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
