"""Plain background is found around objects and never inside."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from registry import View
from stereogs_plugins.initializers.consistency_dense.projection import DepthImage, Mask
from stereogs_plugins.initializers.consistency_dense.scene_analysis.plain_background import (
    PlainAreas,
)
from tests.stereogs_plugins.initializers.depth_scenes import camera_at, view_of

HEIGHT, WIDTH = 60, 80
OBJECT = np.s_[15:50, 20:60]
PATCH = np.s_[25:40, 32:48]
"""Inside the object, plain and of the background's colour."""


def photograph(color: tuple[float, float, float], seed: int, noise: float = 0.01) -> View:
    """A textured object with a plain patch, before a backdrop of one colour with a camera's noise."""
    generator = torch.Generator().manual_seed(seed)
    backdrop = torch.tensor(color).expand(HEIGHT, WIDTH, 3).clone()
    image = backdrop.clone()
    image[OBJECT] = torch.rand(35, 40, 3, generator=generator)
    image[PATCH] = backdrop[PATCH]
    image += noise * (torch.rand(image.shape, generator=generator) - 0.5)
    camera = camera_at(0.1 * seed, width=WIDTH, height=HEIGHT, cx=40, cy=30)
    return view_of(camera, image.clamp(0, 1), f"view{seed}")


def found(views: list[View], confirmed: float = 0.0) -> list[Mask]:
    depths: list[DepthImage] = [np.full((HEIGHT, WIDTH), confirmed, np.float32) for _ in views]
    return PlainAreas.of(views).backgrounds(depths)


@pytest.mark.parametrize("color", [(0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (0.3, 0.5, 0.8)])
def test_a_backdrop_of_any_color_is_found_and_the_object_is_not(
    color: tuple[float, float, float],
) -> None:
    for mask in found([photograph(color, seed) for seed in range(3)]):
        assert not mask[OBJECT].any()
        assert mask[:12].all()
        assert mask.mean() > 0.6


def test_a_textured_backdrop_is_not_background() -> None:
    assert not any(m.any() for m in found([photograph((0.5, 0.5, 0.5), s, 0.3) for s in range(3)]))


def test_a_color_at_the_border_of_one_view_is_not_background() -> None:
    views = [photograph((0.5, 0.5, 0.5), 0), *(photograph((0.5,) * 3, s, 0.3) for s in (1, 2))]
    assert not any(mask.any() for mask in found(views))


def test_a_confirmed_area_is_a_surface() -> None:
    assert not any(m.any() for m in found([photograph((0.2, 0.2, 0.2), s) for s in range(3)], 5.0))


def test_alpha_gives_the_background() -> None:
    alpha = torch.zeros(HEIGHT, WIDTH)
    alpha[10:30] = 1.0
    views = [replace(photograph((1.0, 1.0, 1.0), seed), alpha=alpha) for seed in range(2)]
    for mask in found(views):
        assert np.array_equal(mask, alpha.numpy() == 0)
