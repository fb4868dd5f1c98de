from __future__ import annotations

import pytest
import torch
from torch import Tensor

from core_rasterizer import Camera, Rendering
from registry import PointCloud, Scene, Unavailable, View
from stereogs_plugins.metrics.depth_error import (
    DepthError,
    DepthWithin,
    stereogs_register_metrics,
)
from stereogs_plugins.scenes.procedural import ProceduralScene
from tests.stereogs_plugins.building import build, offered

TRUTH = torch.tensor([[2.0, 2.0, 4.0, 4.0], [2.0, 2.0, 4.0, 0.0]])
"""The last pixel's depth is not known."""
CAMERA = Camera(torch.eye(4), 4, 4, 2, 1, 4, 2)


def rendered(depth: Tensor, alpha: Tensor | float = 1.0) -> Rendering:
    """A render whose normalised depth is `depth`."""
    alphas = torch.as_tensor(alpha).expand(2, 4).contiguous()
    return Rendering(torch.zeros(2, 4, 3), depth * alphas, alphas)


def view(depth: Tensor | None = TRUTH, mask: Tensor | None = None) -> View:
    return View("v", CAMERA, torch.zeros(2, 4, 3), mask, depth=depth)


def scene(points: Tensor | None = None) -> Scene:
    cloud = None if points is None else PointCloud(points, torch.zeros_like(points))
    return Scene("s", (view(),), (), (1.0, 10.0), cloud)


def test_are_offered() -> None:
    names = {"depth_error": DepthError, "depth_within": DepthWithin}
    assert offered(stereogs_register_metrics) == names


def test_the_true_depth_has_no_error() -> None:
    render = rendered(TRUTH, 0.75)
    assert build(DepthError).measure_view(render, view(), scene()) == pytest.approx(0, abs=1e-7)
    assert build(DepthWithin).measure_view(render, view(), scene()) == 1


def test_the_error_is_relative_to_the_truth() -> None:
    depth = TRUTH.clone()
    depth[0, 0], depth[0, 2] = 2.2, 3.0
    render = rendered(depth)
    expected = (0.1 + 0.25) / 7
    assert build(DepthError).measure_view(render, view(), scene()) == pytest.approx(expected)


@pytest.mark.parametrize(("percent", "share"), [(1.0, 4 / 7), (3.0, 5 / 7), (10.0, 6 / 7)])
def test_shares_within_a_tolerance(percent: float, share: float) -> None:
    factors = torch.tensor([[1.02, 1.0, 0.91, 1.0], [1.2, 1.0, 1.0, 9.0]])
    metric = build(DepthWithin, percent=percent)
    assert metric.measure_view(rendered(TRUTH * factors), view(), scene()) == pytest.approx(share)


def test_a_hole_counts_as_wholly_wrong() -> None:
    alpha = torch.ones(2, 4)
    alpha[0, 0], alpha[0, 1] = 0.0, 0.4
    render = rendered(TRUTH, alpha)
    assert build(DepthError).measure_view(render, view(), scene()) == pytest.approx(2 / 7)
    assert build(DepthWithin).measure_view(render, view(), scene()) == pytest.approx(5 / 7)


def test_only_pixels_inside_the_mask_count() -> None:
    mask = torch.zeros(2, 4, dtype=torch.bool)
    mask[:, :2] = True
    depth = torch.where(mask, TRUTH * 1.5, 100.0)
    metric = build(DepthError)
    assert metric.measure_view(rendered(depth), view(mask=mask), scene()) == pytest.approx(0.5)
    empty = torch.zeros_like(mask)
    answer = metric.measure_view(rendered(depth), view(mask=empty), scene())
    assert answer == Unavailable("the view has no pixel with true depth")


@pytest.mark.parametrize("metric", [DepthError, DepthWithin])
def test_without_a_truth_it_says_so(metric: type[DepthError]) -> None:
    for settings in ({"against": "depth"}, {"against": "points"}):
        answer = build(metric, **settings).measure_view(rendered(TRUTH), view(None), scene())
        assert isinstance(answer, Unavailable)


def test_points_are_projected_into_the_view() -> None:
    # Column 4 * x / z + 2, row 4 * y / z + 1; of these the second lies behind, the third beside.
    points = torch.tensor([[-0.75, -0.25, 2.0], [0, 0, -2], [9, 0, 2], [0.5, 0.5, 4]])
    depth = torch.full((2, 4), 50.0)
    depth[0, 0] = 2.2  # -0.75 * 2 + 2 = 0.5, -0.25 * 2 + 1 = 0.5
    depth[1, 2] = 5.0  # 0.5 + 2 = 2.5, 0.5 + 1 = 1.5
    metric = build(DepthError, against="points")
    assert metric.measure_view(rendered(depth), view(), scene(points)) == pytest.approx(0.175)
    mask = torch.ones(2, 4, dtype=torch.bool)
    mask[0, 0] = False
    masked = metric.measure_view(rendered(depth), view(mask=mask), scene(points))
    assert masked == pytest.approx(0.25)


def test_the_procedural_rooms_points_lie_on_its_depth() -> None:
    room = build(ProceduralScene, width=64, height=48, point_noise=0.0, train_views=1).load()
    first = room.train[0]
    assert first.depth is not None
    render = Rendering(first.image, first.depth, torch.ones(48, 64))
    assert build(DepthError).measure_view(render, first, room) == 0
    error = build(DepthError, against="points").measure_view(render, first, room)
    assert isinstance(error, float)
    assert error < 0.02
