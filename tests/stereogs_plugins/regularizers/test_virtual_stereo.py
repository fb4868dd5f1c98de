from __future__ import annotations

from dataclasses import replace
from functools import partial

import pytest
import torch

from core_rasterizer import Camera, GaussianModel, Gaussians, open_device
from registry import Scene, Step, View
from registry.testing import step_of
from stereogs_plugins.regularizers.virtual_stereo import (
    VirtualStereo,
    edge_aware_smoothness,
    moved_back,
)
from tests.stereogs_plugins.building import build, moment_with, some_gaussians


def random(*shape: int) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(3), dtype=torch.float64)


def test_a_whole_disparity_moves_columns_and_leaves_nothing_outside() -> None:
    image = random(4, 10, 3)
    back, inside = moved_back(image, torch.full((4, 10), -3.0, dtype=torch.float64))
    torch.testing.assert_close(back[:, 3:], image[:, :-3])
    assert not back[:, :3].any()
    assert inside.tolist() == [[False] * 3 + [True] * 7] * 4
    whole, everywhere = moved_back(image, torch.zeros(4, 10, dtype=torch.float64))
    torch.testing.assert_close(whole, image)
    assert everywhere.all()


def test_between_two_columns_it_is_bilinear() -> None:
    image = random(2, 6, 3)
    back, _ = moved_back(image, torch.full((2, 6), 1.25, dtype=torch.float64))
    torch.testing.assert_close(back[:, :4], 0.75 * image[:, 1:5] + 0.25 * image[:, 2:])


def test_its_gradients_are_those_of_finite_differences() -> None:
    image, disparity = random(3, 6, 3).requires_grad_(), (random(3, 6) - 0.45).requires_grad_()
    seen = random(3, 6) > 0.2
    torch.autograd.gradcheck(lambda i, d: moved_back(i, d)[0], (image, disparity))
    photograph = random(3, 6, 3)
    torch.autograd.gradcheck(
        lambda d: edge_aware_smoothness(d, photograph, seen),
        (3 * disparity.detach().requires_grad_(),),
    )


def test_smoothness_is_the_slope_and_edges_lessen_it() -> None:
    ramp = torch.arange(6.0)[None].expand(5, 6)
    flat, seen = torch.zeros(5, 6, 3), torch.ones(5, 6, dtype=torch.bool)
    assert float(edge_aware_smoothness(ramp, flat, seen)) == pytest.approx(1.0)
    striped = torch.arange(6.0)[None, :, None].expand(5, 6, 3)  # |I'| = 1 along columns
    expected = float(torch.tensor(-0.33).exp())
    assert float(edge_aware_smoothness(ramp, striped, seen)) == pytest.approx(expected)
    assert float(edge_aware_smoothness(ramp, flat, ~seen)) == 0


def wall(photograph: torch.Tensor, opacity: float = 0.9) -> tuple[Step, GaussianModel]:
    """A rough wall at depth 4 that shows what the photograph does, 40x30, in double precision."""
    camera = Camera(torch.eye(4), 40, 40, 20, 15, 40, 30)
    u, v = camera.pixel_centers()
    places = camera.unproject(u, v, 4 + 0.02 * random(30, 40)).reshape(-1, 3).float()
    sizes, opacities = torch.full((1200,), 0.05), torch.full((1200,), opacity)
    gaussians = Gaussians.from_points(places, photograph.reshape(-1, 3), sizes, opacities, 0)
    model = GaussianModel(gaussians, open_device(), dtype=torch.float64)
    return step_on(model, View("wall", camera, photograph)), model


def step_on(model: GaussianModel, *views: View) -> Step:
    scene = Scene("wall", views, (), (1.0, 16.0))
    return step_of(model, scene, rendering=model.render(views[0].camera))


def loss_of(step: Step, **settings: object) -> float:
    return float(build(VirtualStereo, 1, **settings).loss(step).detach())


def patches() -> torch.Tensor:
    coarse = random(3, 5, 3).float().permute(2, 0, 1)[None]
    return torch.nn.functional.interpolate(coarse, (30, 40), mode="bilinear")[0].permute(1, 2, 0)


def test_a_wall_at_its_depth_agrees_with_its_photograph_from_both_sides() -> None:
    photograph = patches().contiguous()
    step, _ = wall(photograph)
    for seed in range(4):
        loss = build(VirtualStereo, seed, max_shift=0.8, smoothness=0.0).loss(step)
        assert float(loss.detach()) < 0.02  # blur; half a pixel of error would make more than 0.03


def test_the_shift_of_the_paper_moves_near_content_by_ten_pixels() -> None:
    # LLFF at an eighth: f = 407 px, near 16.2; the largest shift is 0.4.
    _, inside = moved_back(torch.zeros(1, 504, 3), torch.full((1, 504), -407 * 0.4 / 16.2))
    assert int((~inside).sum()) == 11


def test_a_shift_in_baselines_is_relative_to_the_nearest_other_camera() -> None:
    photograph = patches().contiguous()
    step, model = wall(photograph)
    camera = step.view.camera
    views = [View(f"{d}", camera.shifted_right(d), photograph) for d in (0.0, -0.8, 2.0)]
    several = step_on(model, *views)
    assert loss_of(several, max_shift=0.5, unit="baseline") == loss_of(step, max_shift=0.4)
    alone = loss_of(step, max_shift=0.5, unit="baseline")
    assert alone == loss_of(step, max_shift=0.5 * step.extent) != loss_of(step, max_shift=0.5)


def test_a_refined_camera_does_not_change_the_baseline() -> None:
    step, model = wall(patches().contiguous())
    views = [View(f"{d}", step.view.camera.shifted_right(d), step.view.image) for d in (0.0, 2.0)]
    several = step_on(model, *views)
    refined = replace(several.sample, camera=several.sample.camera.shifted_right(0.5))
    unit = build(VirtualStereo, 1, unit="baseline")._unit(replace(several, sample=refined))
    assert unit == pytest.approx(2.0)


def test_expected_depth_agrees_where_the_wall_is_transparent() -> None:
    step, model = wall(patches().contiguous(), opacity=0.25)
    camera, alpha = step.view.camera, step.rendering.alpha.detach()
    assert 0.4 < float(alpha.mean()) < 0.9
    step = step_on(model, View("wall", camera, step.rendering.rgb.detach()))
    blended, expected = (
        loss_of(step, max_shift=0.8, smoothness=0.0, depth=d) for d in ("accumulated", "expected")
    )
    assert expected < 0.5 * blended


def test_with_expected_depth_pixels_that_are_not_solid_are_ignored() -> None:
    photograph = patches().contiguous()
    step, model = wall(photograph)
    photograph[:, 25:] = 1 - photograph[:, 25:]
    alpha = torch.ones(30, 40)
    alpha[:, 25:] = 0.9
    some, all_of_it = (
        loss_of(
            step_on(model, View("wall", step.view.camera, photograph, alpha=a)),
            **{"smoothness": 0.0, "depth": "expected"},
        )
        for a in (alpha, None)
    )
    assert some < 0.02 < all_of_it


@pytest.mark.parametrize("settings", [{}, {"depth": "expected"}])
def test_its_gradient_moves_the_gaussians_as_finite_differences_say(
    settings: dict[str, object],
) -> None:
    step, model = wall(patches().contiguous())
    model.zero_gradients()
    build(VirtualStereo, 1, **settings).loss(step).backward()
    means = model.read("means").clone()
    direction = random(1200, 3) - 0.5
    along = float((model.gradient("means") * direction).sum())

    def loss_at(distance: float) -> float:
        model.write("means", means + distance * direction)
        return loss_of(step_on(model, View("wall", step.view.camera, step.view.image)), **settings)

    assert along == pytest.approx((loss_at(1e-7) - loss_at(-1e-7)) / 2e-7, rel=1e-3)


def test_nothing_to_see_gives_no_loss_of_its_own() -> None:
    step, model = moment_with(some_gaussians([0.1], [0.003]))
    step.rendered(partial(model.render, step.view.camera))
    loss = build(VirtualStereo).loss(step)
    assert float(loss.detach()) == 0
    loss.backward()
    assert not model.gradient("means").any()
