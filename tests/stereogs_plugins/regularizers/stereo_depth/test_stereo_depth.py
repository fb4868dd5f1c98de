from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from core_rasterizer import Camera, Rendering
from registry import Frame, PluginError, Settings
from registry.priors import StereoPrior
from stereogs_plugins.regularizers.stereo_depth import StereoDepth, stereogs_register_regularizers
from tests.stereogs_plugins.building import build, offered
from tests.stereogs_plugins.regularizers.stereo_depth.block_matching import (
    BASELINE,
    DEPTH,
    FOCAL,
    HEIGHT,
    WIDTH,
    BlockMatcher,
    Wall,
    wall,
)

WORLD = {"mode": "world", "value": BASELINE}
TRUE_DISPARITY = FOCAL * BASELINE / DEPTH


def stereo_depth(**settings: Any) -> StereoDepth:
    return build(StereoDepth, **{"baseline": WORLD, "depth": "expected", **settings})


class Told(StereoPrior[Settings]):
    """Answers with maps that a test gives it."""

    def tell(self, left: Tensor, right: Tensor) -> Told:
        """Take the answers of both sides."""
        self.answers = (left, right)
        return self

    def estimate(self, left: Tensor, right: Tensor) -> Tensor:
        """The left answer."""
        return self.answers[0]

    def estimate_both(self, left: Tensor, right: Tensor) -> tuple[Tensor, Tensor]:
        """Both answers."""
        return self.answers


def told(left: Tensor, right: Tensor | None = None) -> Told:
    return build(Told).tell(left, left if right is None else right)


def everywhere(disparity: float) -> Tensor:
    return torch.full((HEIGHT, WIDTH), disparity)


def test_is_offered_as_stereo_depth() -> None:
    assert offered(stereogs_register_regularizers) == {"stereo_depth": StereoDepth}


def test_the_right_view_has_the_photographs_background() -> None:
    step = Wall().step(m=told(everywhere(TRUE_DISPARITY)))
    backgrounds = []

    def render(camera: Camera, **how: Any) -> Rendering:
        backgrounds.append(how.get("background"))
        return step.render(camera, **how)

    # As `random_background` puts it there.
    sample = replace(step.sample, background=(1.0, 0.0, 1.0))
    stereo_depth().loss(replace(step, sample=sample, render=render))
    assert backgrounds[-1] == step.scene.background


def test_true_geometry_costs_a_fraction_of_a_pixel() -> None:
    around = Wall()
    loss = stereo_depth(normalize="disparity").loss(around.step(m=build(BlockMatcher)))
    assert float(loss.detach()) < 0.05
    assert around.logged["under test_valid"] > 0.8
    assert around.logged["under test_occluded"] < 0.2
    assert around.logged["under test_baseline"] == BASELINE


@pytest.mark.parametrize("depth", ["accumulated", "expected"])
@pytest.mark.parametrize("moved_to", [3.6, 4.4])
def test_the_gradient_moves_gaussians_back_to_the_true_depth(depth: str, moved_to: float) -> None:
    around, matcher = Wall(), build(BlockMatcher)
    regularizer = stereo_depth(depth=depth, refresh_threshold=1.0)
    regularizer.loss(around.step(m=matcher))
    around.model.write("means", wall(moved_to).means)  # the same picture from the left
    around.model.write("log_scales", wall(moved_to).log_scales)
    step = around.step(m=matcher)
    loss = regularizer.loss(step)
    assert around.logged["under test_reused"] == 1
    expected = abs(1 / moved_to - 1 / DEPTH)
    assert float(loss.detach()) == pytest.approx(expected, rel=0.2)
    loss.backward()
    along = step.model.gradient("means")[:, 2]
    moved = along[along != 0]
    assert len(moved) > 500
    # A step against the gradient: forwards if too near, backwards if too far.
    towards = moved < 0 if moved_to < DEPTH else moved > 0
    assert towards.float().mean() > 0.95


def plain_loss(regularizer: StereoDepth, around: Wall, prior: StereoPrior[Any]) -> float:
    return float(regularizer.loss(around.step(m=prior)).detach())


@pytest.mark.parametrize(
    ("normalize", "unit"),
    [
        ("none", 1.0),
        ("zref", DEPTH * TRUE_DISPARITY / 12),
        ("disparity", FOCAL * BASELINE),
    ],
)
def test_reductions_and_units_exactly(normalize: str, unit: float) -> None:
    """A disparity of 12 px where 10 is true, in the middle third only."""
    answer = everywhere(math.nan)
    answer[:, 32:64] = 12
    around = Wall()
    rendering = around.model.render(around.view.camera)
    rendered = (rendering.alpha / rendering.depth).detach()[:, 32:64]
    terms = (rendered - 12 / (FOCAL * BASELINE)).abs().double() * unit
    pixels = HEIGHT * 32
    for reduction, divisor in (("mean_valid", pixels), ("mean_all", 3 * pixels), ("sum", 1)):
        regularizer = stereo_depth(normalize=normalize, reduction=reduction, validity_mask=False)
        loss = plain_loss(regularizer, around, told(answer))
        assert loss == pytest.approx(float(terms.sum()) / divisor, rel=1e-5)
    assert around.logged["under test_valid"] == pytest.approx(1 / 3)


def test_accumulated_depth_feels_opacities_and_expected_depth_does_not() -> None:
    faint = wall()
    faint.opacity_logits[:] = -2.0
    around = Wall(faint)
    prior = told(everywhere(TRUE_DISPARITY))
    slopes = {}
    for depth in ("accumulated", "expected"):
        regularizer = stereo_depth(depth=depth, validity_mask=False)
        step = around.step(m=prior)
        regularizer.loss(step).backward()
        slopes[depth] = float(step.model.gradient("opacity_logits").abs().sum())
    assert slopes["expected"] < 1e-3 * slopes["accumulated"]


@pytest.mark.parametrize("poison", [math.nan, math.inf, -math.inf, 0.0, -3.0, 0.09])
def test_what_is_no_disparity_never_reaches_the_loss(poison: float) -> None:
    answer = everywhere(TRUE_DISPARITY)
    answer[::2] = poison
    around = Wall()
    step = around.step(m=told(answer))
    loss = stereo_depth(validity_mask=False).loss(step)
    assert float(loss.detach()) < 0.01
    assert around.logged["under test_valid"] == 0.5
    loss.backward()
    assert torch.isfinite(step.model.gradient("means")).all()


@pytest.mark.parametrize("poison", [math.nan, 0.0, -1.0])
def test_without_a_pixel_to_trust_the_loss_is_zero(poison: float) -> None:
    around, prior = Wall(), told(everywhere(poison))
    regularizer = stereo_depth()
    for count in (1, 2):
        step = around.step(m=prior)
        (regularizer.loss(step) + 0 * step.rendering.rgb.sum()).backward()
        assert not step.model.gradient("means").any()
        assert around.logged["under test_skipped"] == count


def test_nothing_rendered_is_nothing_to_trust() -> None:
    behind = wall()
    behind.means[:, 2] = -3
    around = Wall(behind)
    loss = stereo_depth(validity_mask=False).loss(around.step(m=told(everywhere(10.0))))
    assert float(loss.detach()) == 0
    assert around.logged["under test_skipped"] == 1


def test_pixels_just_before_the_camera_are_left_out() -> None:
    """The near bound is 2, so depths below 0.002 have no use."""
    around = Wall()
    step = around.step(m=told(everywhere(TRUE_DISPARITY)))
    depth = everywhere(DEPTH)
    depth[:12], depth[12:24] = 0.0019, 0.0021
    close = Rendering(step.view.image, depth, torch.ones_like(depth))
    step.rendered(lambda: close)
    stereo_depth(validity_mask=False).loss(step)
    assert around.logged["under test_valid"] == 0.75


def test_the_left_right_check_and_its_ablation() -> None:
    left, right = everywhere(TRUE_DISPARITY), everywhere(TRUE_DISPARITY)
    right[:, : WIDTH // 2] += 3
    hidden = (HEIGHT * (WIDTH // 2 + TRUE_DISPARITY)) / (HEIGHT * WIDTH)
    around = Wall()
    for mask, valid in ((True, 1 - hidden), (False, 1.0)):
        stereo_depth(validity_mask=mask).loss(around.step(m=told(left, right)))
        assert around.logged["under test_valid"] == pytest.approx(valid)
        assert around.logged["under test_occluded"] == pytest.approx(hidden)


def test_tau_is_in_pixels() -> None:
    around = Wall()
    prior = told(everywhere(TRUE_DISPARITY), everywhere(TRUE_DISPARITY + 3))
    for tau, valid in ((2.9, 0.0), (3.1, 1 - TRUE_DISPARITY / WIDTH)):
        stereo_depth(tau=tau).loss(around.step(m=prior))
        assert around.logged["under test_valid"] == pytest.approx(valid)


def test_backgrounds_are_left_out() -> None:
    alpha = torch.ones(HEIGHT, WIDTH)
    alpha[:, 48] = 0.5  # the rim
    alpha[:, 49:] = 0
    around, prior = Wall(alpha=alpha), told(everywhere(TRUE_DISPARITY))
    stereo_depth().loss(around.step(m=prior))
    assert around.logged["under test_valid"] == pytest.approx((48 - TRUE_DISPARITY) / WIDTH)
    stereo_depth(background="none").loss(around.step(m=prior))
    assert around.logged["under test_valid"] == pytest.approx((WIDTH - TRUE_DISPARITY) / WIDTH)
    around.view.image[:, :60] = 0
    stereo_depth(background="intensity").loss(around.step(m=prior))
    assert around.logged["under test_valid"] == pytest.approx((WIDTH - 60) / WIDTH)


def test_the_prior_is_asked_again_only_after_a_change() -> None:
    around, matcher = Wall(), build(BlockMatcher)
    regularizer = stereo_depth(refresh_threshold=0.01)
    for _ in range(3):
        regularizer.loss(around.step(m=matcher))
    assert matcher.asked == 2  # once for each side
    assert around.logged["under test_seconds"] == 0
    sh = around.model.read("sh").flip(0)
    around.model.write("sh", sh)
    regularizer.loss(around.step(m=matcher))
    assert matcher.asked == 4
    assert around.logged["under test_seconds"] > 0
    assert around.logged["under test_inferences"] == 2
    assert around.logged["under test_reused"] == 2


def test_a_resumed_run_goes_on_with_the_same_bits() -> None:
    around, matcher = Wall(), build(BlockMatcher)
    settings = {"baseline": {"mode": "adaptive"}, "refresh_threshold": 0.02}
    first, second = stereo_depth(**settings), stereo_depth(**settings)
    first.loss(around.step(m=matcher))
    around.model.write("means", wall().means + torch.tensor([0.0, 0.0, 0.05]))
    second.restore(first.state())
    asked = matcher.asked
    losses = [r.loss(around.step(m=matcher)) for r in (first, second)]
    assert matcher.asked == asked
    assert torch.equal(*losses)
    fresh = stereo_depth(**settings).loss(around.step(m=matcher))
    assert not torch.equal(fresh, losses[0])
    states = first.state(), second.state()
    assert states[0].keys() == states[1].keys()
    assert all(torch.equal(states[0][key], states[1][key]) for key in states[0])


def test_the_first_prior_settles_the_baseline_within_its_reach() -> None:
    around = Wall()
    build(StereoDepth).loss(around.step(m=build(BlockMatcher, reach=10)))
    assert FOCAL * around.logged["under test_baseline"] / DEPTH == pytest.approx(9.0, rel=1e-4)


def test_a_baseline_without_overlap_and_a_missing_prior_are_explained() -> None:
    step = Wall().step(m=told(everywhere(10.0)))
    # Settings and messages are in units of the files, whatever the frame of training is.
    for unit in (1.0, 0.5):
        placed = replace(step, scene=replace(step.scene, frame=Frame(unit=unit)))
        with pytest.raises(PluginError, match="`value` 8, is too long") as caught:
            stereo_depth(baseline={"mode": "world", "value": 8.0}).loss(placed)
        most = float(caught.value.fix.split()[-3])
        assert most == pytest.approx(unit * 0.35 * WIDTH * DEPTH / FOCAL, rel=0.01)
    with pytest.raises(PluginError, match="stereo_disparity"):
        stereo_depth().loss(Wall().step())
