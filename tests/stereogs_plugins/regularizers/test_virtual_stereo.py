from __future__ import annotations

from dataclasses import replace
from functools import partial

import pytest
import torch

from core_rasterizer import Camera, GaussianModel, Gaussians, Rendering
from registry import Scene, Step, View
from registry.testing import check_term, step_of
from stereogs_plugins.regularizers.virtual_stereo import Kind, VirtualStereo, term
from tests.core_rasterizer.quick_device import quick_device
from tests.stereogs_plugins.building import build, moment_with, some_gaussians


def random(*shape: int) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(3), dtype=torch.float64)


def moved_back(image: torch.Tensor, disparity: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Warp the image of the shifted camera to the unshifted camera.

    Args:
        image: `[H, W, 3]` of the shifted camera.
        disparity: `[H, W]` pixels: pixel (u, v) of the unshifted camera corresponds to (u + d, v).

    Returns:
        `[H, W, 3]`, bilinear in columns and 0 outside the image; and `[H, W]` bool, True inside the image.
    """
    height, width = disparity.shape
    columns = torch.arange(width, dtype=disparity.dtype) + disparity
    inside = (columns >= 0) & (columns <= width - 1)
    position = columns.clamp(0, width - 1)
    left = position.detach().floor().clamp(0, max(width - 2, 0))
    part = (position - left)[:, :, None]
    # index_select and its gradient take two thirds of the time of image[rows, columns].
    index = (left.long() + width * torch.arange(height)[:, None]).flatten()
    pixels = image.reshape(height * width, -1)
    first, second = (
        pixels.index_select(0, at).view_as(image) for at in (index, index + min(1, width - 1))
    )
    return (first + part * (second - first)) * inside[:, :, None], inside


def edge_aware_smoothness(
    disparity: torch.Tensor, image: torch.Tensor, seen: torch.Tensor
) -> torch.Tensor:
    """Return mean |d'| exp(-0.33 |I'|) over columns plus the same over rows, by central differences.

    Args:
        disparity: `[H, W]`.
        image: `[H, W, 3]`; |I'| is the mean over its channels.
        seen: `[H, W]` bool; a difference counts where both its pixels are seen.
    """
    total = disparity.new_zeros(())
    for axis in (0, 1):
        d, i, s = (x.transpose(0, axis) for x in (disparity, image, seen))
        if len(d) < 3:
            continue
        both = s[2:] & s[:-2]
        slope = (0.5 * (d[2:] - d[:-2])).abs() * both
        red, green, blue = (0.5 * (i[2:] - i[:-2])).abs().unbind(2)
        edge = (red + green + blue) / 3  # three times as fast as mean(2)
        total = total + (slope * (-0.33 * edge).exp()).mean()
    return total


def reference(
    view: Rendering,
    shifted: Rendering,
    target: torch.Tensor,
    trained: torch.Tensor | None,
    solid: torch.Tensor | None,
    moves: float,
    smoothness: float,
    expected: bool,
) -> torch.Tensor:
    """The loss in torch."""
    depth, seen = view.depth, torch.ones(view.depth.shape, dtype=torch.bool)
    if expected:
        seen = view.alpha.detach() > 0.3
        seen = seen if solid is None else seen & solid
        depth = depth / view.alpha.where(seen, 1.0)
    seen = seen & (depth.detach() * seen.shape[1] > abs(moves))
    seen = seen if trained is None else seen & trained
    disparity = moves / depth.where(seen, torch.inf)
    warped, inside = moved_back(shifted.rgb, disparity)
    difference = (warped - target).abs() * (inside & seen)[:, :, None]
    return difference.mean() + smoothness * edge_aware_smoothness(disparity, target, seen)


@pytest.mark.parametrize("kind", ["accumulated", "expected"])
@pytest.mark.parametrize(
    ("size", "moves"),
    [((9, 14), 9.0), ((9, 14), -3.0), ((1, 1), 0.5), ((2, 3), -3.0), ((3, 2), 0.0)],
)
@pytest.mark.parametrize("masked", [False, True])
def test_the_kernel_agrees_with_torch(
    kind: Kind, size: tuple[int, int], moves: float, masked: bool
) -> None:
    # Depths from 0 to 3: disparities from 3 pixels to beyond the image, and pixels that are not seen.
    colors, depth, alpha = random(*size, 3), 3 * random(*size), random(*size).roll(1, 0)
    mask = random(*size).flip(1) > 0.3
    check_term(
        term(kind),
        partial(reference, expected=kind == "expected"),
        view=Rendering(colors, depth, alpha),
        shifted=Rendering(colors, depth, alpha),
        target=colors.flip(0),
        trained=mask if masked else None,
        solid=mask.flip(0) if masked and kind == "expected" else None,
        moves=moves,
        smoothness=0.7,
        device=quick_device(),
    )


def wall(photograph: torch.Tensor, opacity: float = 0.9) -> tuple[Step, GaussianModel]:
    """A rough wall at depth 4 that shows what the photograph does, 40x30, in double precision."""
    camera = Camera(torch.eye(4), 40, 40, 20, 15, 40, 30)
    u, v = camera.pixel_centers()
    places = camera.unproject(u, v, 4 + 0.02 * random(30, 40)).reshape(-1, 3).float()
    sizes, opacities = torch.full((1200,), 0.05), torch.full((1200,), opacity)
    gaussians = Gaussians.from_points(places, photograph.reshape(-1, 3), sizes, opacities, 0)
    model = GaussianModel(gaussians, quick_device(), dtype=torch.float64)
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
