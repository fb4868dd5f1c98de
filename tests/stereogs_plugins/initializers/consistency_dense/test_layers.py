"""Points on surfaces, behind edges and around images."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from stereogs_plugins.initializers.consistency_dense.completion.back_layer import back_layer
from stereogs_plugins.initializers.consistency_dense.completion.margin import margin
from stereogs_plugins.initializers.consistency_dense.completion.merging import (
    back_layers,
    margins,
    surfaces,
)
from stereogs_plugins.initializers.consistency_dense.layers import surface
from stereogs_plugins.initializers.consistency_dense.projection import inside, project
from stereogs_plugins.initializers.consistency_dense.view_depth import ViewDepth
from tests.stereogs_plugins.initializers.depth_scenes import camera_at, known, view_of

RED, GREEN = (0.9, 0.1, 0.1), (0.1, 0.7, 0.1)
BOUNDS = (1.0, 10.0)


def box_before_wall(half: int, *, width: int = 120, height: int = 100) -> ViewDepth:
    """A red square at depth 2, `half` pixels to each side, in the middle of a green wall at 6."""
    camera = camera_at(0.0, width=width, height=height, cx=width / 2, cy=height / 2)
    image = torch.tensor(GREEN).expand(height, width, 3).clone()
    depth = np.full((height, width), 6.0, dtype=np.float32)
    box = np.s_[height // 2 - half : height // 2 + half, width // 2 - half : width // 2 + half]
    image[box] = torch.tensor(RED)
    depth[box] = 2.0
    return known(view_of(camera, image), depth)


def test_a_surface_has_a_point_for_each_cell_with_its_mean_color() -> None:
    image = torch.rand(40, 60, 3, generator=torch.Generator().manual_seed(0))
    depth = np.full((40, 60), 3.0, dtype=np.float32)
    depth[:, 30:] = 5.0
    view = known(view_of(camera_at(0.0), image), depth)
    layer = surface(view, view.confirmed > 0, 4)
    assert len(layer) == 10 * 15
    u, _, z = project(view.camera, layer.positions)
    np.testing.assert_allclose(u[:2], [2.5, 6.5])
    np.testing.assert_allclose(layer.spacings, 4 * z / 50)
    np.testing.assert_allclose(layer.colors[0], image[:4, :4].mean(dim=(0, 1)), rtol=1e-5)
    # The cell of columns 28 to 31 lies across the edge; its middle, column 30, on the far side.
    np.testing.assert_allclose(z[7], 5.0, rtol=1e-6)
    np.testing.assert_allclose(layer.colors[7], image[:4, 30:32].mean(dim=(0, 1)), rtol=1e-5)


def test_a_surface_skips_unknown_and_unwanted_pixels() -> None:
    depth = np.full((40, 60), 3.0, dtype=np.float32)
    depth[:20] = 0
    wanted = np.zeros((40, 60), dtype=np.bool_)
    wanted[:, :30] = True
    view = known(view_of(camera_at(0.0)), depth)
    u, v, _ = project(view.camera, surface(view, wanted, 2).positions)
    assert len(u) == 10 * 15
    assert (u < 30).all()
    assert (v > 20).all()


def test_merging_leaves_one_point_where_two_views_agree() -> None:
    depth = np.full((40, 60), 3.0, dtype=np.float32)
    views = [known(view_of(camera_at(x)), depth) for x in (0.0, 0.6)]
    both = surfaces(views, BOUNDS, stride=1, merge=False)["confirmed"]
    merged = surfaces(views, BOUNDS, stride=1, merge=True)["confirmed"]
    assert len(both) == 2 * 40 * 60
    assert len(merged) == 40 * 60 + 40 * 10  # the second camera sees 50 * .6 / 3 columns more


@pytest.mark.parametrize("half", [12, 40])
def test_the_back_layer_lies_behind_and_looks_like_the_background(half: int) -> None:
    view = box_before_wall(half)
    layer = back_layer(view)
    u, v, z = project(view.camera, layer.positions)
    assert len(layer) == len({*zip(u.round(2), v.round(2), strict=True)}) > 0
    np.testing.assert_allclose(z, 6.0, rtol=1e-6)
    assert (np.maximum(np.abs(u - 60), np.abs(v - 50)) <= half).all()
    np.testing.assert_allclose(layer.colors, np.broadcast_to(GREEN, (len(layer), 3)), atol=1e-6)
    # Cells of 8 pixels fill the square behind the box, in the middle of a large one too.
    assert abs(len(layer) - (2 * half / 8) ** 2) < 2.5 * half / 8 + 2


def test_there_is_no_back_layer_without_an_edge_or_without_depth() -> None:
    flat = np.full((40, 60), 3.0, dtype=np.float32)
    assert len(back_layer(known(view_of(camera_at(0.0)), flat))) == 0
    assert len(back_layer(known(view_of(camera_at(0.0)), np.zeros_like(flat)))) == 0


def test_other_views_refute_and_replace_the_back_layer() -> None:
    view = box_before_wall(12)
    alone = len(back_layers([view], BOUNDS))
    beyond = np.full((100, 120), 9.0, dtype=np.float32)  # sees through where the wall should be
    same = np.full((100, 120), 6.0, dtype=np.float32)  # sees the wall itself
    assert alone > 0
    beside = view_of(camera_at(0.01, width=120, height=100, cx=60, cy=50))
    for depth in (beyond, same):
        assert len(back_layers([view, known(beside, depth)], BOUNDS)) == 0


def test_the_margin_surrounds_the_image_at_the_backgrounds_depth() -> None:
    view = box_before_wall(50)  # the box reaches the upper and lower border
    layer = margin(view)
    u, v, z = project(view.camera, layer.positions)
    assert not inside(view.confirmed.shape, u, v).any()
    assert u.min() < -50
    assert u.max() > 170
    assert v.min() < -40
    assert v.max() > 140
    np.testing.assert_allclose(z, 6.0, rtol=1e-6)
    left = (u < 0) & (np.abs(v - 50) < 20)
    np.testing.assert_allclose(layer.colors[left], [GREEN] * left.sum(), atol=0.25)


def test_the_margin_needs_a_depth_nearby() -> None:
    depth = np.zeros((100, 120), dtype=np.float32)
    view = known(view_of(camera_at(0.0, width=120, height=100, cx=60, cy=50)), depth)
    assert len(margin(view)) == 0


def test_a_margin_ends_where_another_view_sees() -> None:
    depth = np.full((40, 60), 3.0, dtype=np.float32)
    views = [known(view_of(camera_at(x)), depth) for x in (0.0, 1.5)]
    points = margins(views, BOUNDS).positions
    assert len(points) > 0
    for view in views:
        u, v, _ = project(view.camera, points)
        assert not inside(view.confirmed.shape, u, v).any()
