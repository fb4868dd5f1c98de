from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from pydantic import ValidationError

from core_rasterizer import Gaussians, Rendering
from registry import PluginError
from stereogs_plugins.regularizers.stereo_depth.baseline import BaselineSettings, choose_baseline
from tests.stereogs_plugins.regularizers.stereo_depth.block_matching import (
    DEPTH,
    FOCAL,
    HEIGHT,
    WIDTH,
    Wall,
    wall,
)


def chosen(around: Wall | None = None, reach: float | None = None, **settings: object) -> float:
    return choose_baseline(
        BaselineSettings.model_validate(settings), (around or Wall()).step(), reach
    )


def disparity(baseline: float) -> float:
    return FOCAL * baseline / DEPTH


def test_adaptive_gives_near_content_a_share_of_the_width() -> None:
    assert disparity(chosen()) == pytest.approx(0.2 * WIDTH, rel=1e-4)
    assert disparity(chosen(mode="adaptive", value=0.1)) == pytest.approx(0.1 * WIDTH, rel=1e-4)


def test_adaptive_stays_within_a_third_of_the_width_and_the_matchers_reach() -> None:
    assert disparity(chosen(value=0.9)) == pytest.approx(0.35 * WIDTH, rel=1e-4)
    assert disparity(chosen(reach=10.0)) == pytest.approx(9.0, rel=1e-4)


def test_adaptive_gives_the_median_depth_four_pixels() -> None:
    assert disparity(chosen(value=0.01)) == pytest.approx(4.0, rel=1e-4)
    assert disparity(chosen(value=0.01, reach=3.0)) == pytest.approx(2.7, rel=1e-4)


def test_near_is_the_fifth_percentile_not_the_nearest_pixel() -> None:
    floater = torch.tensor([[0.0, 0.0, 1.0]])
    scene = wall()
    speck = Gaussians.from_points(
        floater, torch.zeros(1, 3), torch.tensor([0.01]), torch.tensor([0.99]), 0
    )
    both = Gaussians(
        **{
            name: torch.cat([getattr(speck, name), getattr(scene, name)])
            for name in ("means", "log_scales", "quaternions", "opacity_logits", "sh")
        }
    )
    assert disparity(chosen(Wall(both))) == pytest.approx(0.2 * WIDTH, rel=1e-2)


def test_the_fifth_percentile_of_a_slanted_wall() -> None:
    step = Wall().step()
    depth = torch.linspace(2, 4, WIDTH * HEIGHT).reshape(HEIGHT, WIDTH)
    slanted = Rendering(step.view.image, 0.9 * depth, torch.full_like(depth, 0.9))
    step = replace(step, render=lambda *_, **__: slanted)
    baseline = choose_baseline(BaselineSettings(), step, None)
    assert FOCAL * baseline / 2.1 == pytest.approx(0.2 * WIDTH, rel=1e-3)


def test_without_anything_to_see_the_scenes_bounds_count() -> None:
    behind = wall()
    behind.means[:, 2] = -3
    near = 2.0
    assert FOCAL * chosen(Wall(behind)) / near == pytest.approx(0.2 * WIDTH)


def test_world_and_extent_are_taken_as_given() -> None:
    step = replace(Wall().step(), extent=3.0)
    for mode, expected in (("world", 0.2), ("extent", 0.6)):
        settings = BaselineSettings.model_validate({"mode": mode, "value": 0.2})
        assert choose_baseline(settings, step, None) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("reach", "value", "message"),
    [(None, 5.0, "100 px in an image 96 px wide"), (8.0, 0.5, "10 px, and the prior .* 8 px")],
)
def test_a_baseline_without_overlap_is_refused(
    reach: float | None, value: float, message: str
) -> None:
    with pytest.raises(PluginError, match=message) as caught:
        chosen(mode="world", value=value, reach=reach)
    assert caught.value.where == "view 'wall'"
    suggested = float(caught.value.fix.split(" to ")[-1].removesuffix(" or less"))
    assert chosen(mode="world", value=suggested, reach=reach) == suggested


@pytest.mark.parametrize("mode", ["world", "extent"])
def test_a_mode_without_its_value_is_refused(mode: str) -> None:
    with pytest.raises(ValidationError, match=f"mode {mode} needs a value"):
        BaselineSettings.model_validate({"mode": mode})
