"""A hole is shown elsewhere where a confirmed point of another view falls with its colour."""

from __future__ import annotations

import numpy as np
import torch

from registry import View
from stereogs_plugins.initializers.consistency_dense.completion.guesses import (
    shown_elsewhere,
)
from stereogs_plugins.initializers.consistency_dense.projection import DepthImage, Mask
from stereogs_plugins.initializers.consistency_dense.scene_analysis.contradictions import Evidence
from tests.stereogs_plugins.initializers.depth_scenes import camera_at, view_of

HERE, THERE = camera_at(0.0), camera_at(0.2)
PATCH = np.s_[15:25, 25:35]
NOTHING = np.zeros((40, 60), dtype=np.float32)


def patch(depth: float = 5.0) -> DepthImage:
    known = NOTHING.copy()
    known[PATCH] = depth
    return known


def shown(here: View, there: View, depth: DepthImage) -> Mask:
    return shown_elsewhere(
        Evidence.of(here, NOTHING), [Evidence.of(there, depth)], [there.image.numpy()]
    )


def test_a_patch_is_shown_moved_by_its_disparity() -> None:
    found = shown(view_of(HERE), view_of(THERE), patch())
    disparity = round(0.2 * HERE.fx / 5)
    expected = np.zeros_like(found)
    expected[15:25, 25 + disparity : 35 + disparity] = True
    assert disparity > 0
    assert (found == expected).all()


def test_other_colors_and_views_without_depth_show_nothing() -> None:
    here, there = view_of(HERE), view_of(THERE)
    black = view_of(THERE, torch.zeros_like(there.image))
    assert not shown(here, black, patch()).any()
    assert not shown(here, there, NOTHING).any()


def test_points_of_one_pixel_need_only_one_of_its_color() -> None:
    far = view_of(camera_at(0.0), name="far")
    painted = far.image.clone()
    painted[:, 31:] = 0.0
    both = [Evidence.of(far, patch()), Evidence.of(far, patch())]
    images = [far.image.numpy(), painted.numpy()]
    for order in (images, images[::-1]):
        found = shown_elsewhere(Evidence.of(view_of(HERE), NOTHING), both, order)
        assert (found == (patch() > 0)).all()
