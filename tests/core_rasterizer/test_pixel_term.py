"""Loss terms in one kernel: the same values and gradients as torch, on every kind of device."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from core_rasterizer import (
    Device,
    DeviceError,
    ExplainedError,
    GaussianModel,
    PixelTerm,
    Rendering,
    photometric_loss,
)
from tests.core_rasterizer.scenes import gradients_of, parameters, random_camera

WIDTH, HEIGHT = 37, 21
WEIGHED = PixelTerm(
    """
    #if HAS_seen
    if (!seen[p])
        continue;
    #endif
    for (int c = 0; c < 3; c++) {
        const real error = view_rgb[3 * p + c] - target[3 * p + c];
        loss += power * error * error * view_alpha[p];
        d_view_rgb[3 * p + c] = 2 * power * error * view_alpha[p];
        d_view_alpha[p] += power * error * error;
    }
    """,
    gradients=["view_rgb", "view_alpha"],
)
SLOPE = PixelTerm(
    """
    if (x + 1 < width) {
        const real slope = view_depth[p + 1] - view_depth[p];
        loss += slope * slope;
        d_view_depth[p] -= 2 * slope;
        d_view_depth[p + 1] += 2 * slope;
    }
    """,
    gradients=["view_depth"],
    in_rows=True,
)


def weighed(view: Rendering, target: Tensor, seen: Tensor | None, power: float) -> Tensor:
    errors = power * (view.rgb - target).square() * view.alpha[:, :, None]
    return errors.sum() if seen is None else errors[seen].sum()


def slope(view: Rendering) -> Tensor:
    return view.depth.diff(dim=1).square().sum()


def noise(*shape: int, seed: int = 0) -> Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


@pytest.fixture(params=[True, False], ids=["shared", "discrete"])
def model(device: Device, request: pytest.FixtureRequest) -> GaussianModel:
    chosen = device if request.param else device.as_discrete()
    return GaussianModel(parameters(40), chosen, dtype=torch.float64)


def rendered(model: GaussianModel) -> Rendering:
    return model.render(random_camera(torch.Generator().manual_seed(1), WIDTH, HEIGHT))


def result(model: GaussianModel, total: Callable[[Rendering], Tensor]) -> list[Tensor]:
    """The loss of a new render, and its gradients."""
    model.zero_gradients()
    loss = total(rendered(model))
    loss.backward()
    return [loss.detach(), *gradients_of(model).values()]


TARGET, SEEN = noise(HEIGHT, WIDTH, 3), noise(HEIGHT, WIDTH, seed=1) > 0.3


@pytest.mark.parametrize("seen", [SEEN, None], ids=["masked", "whole"])
def test_terms_agree_with_torch_and_repeat_their_bits(
    model: GaussianModel, seen: Tensor | None
) -> None:
    def fused(view: Rendering) -> Tensor:
        first = WEIGHED(view=view, target=TARGET, seen=seen, power=1.5)
        return 0.3 * first + SLOPE(view=view) + photometric_loss(view, TARGET)

    def torch_only(view: Rendering) -> Tensor:
        loss = photometric_loss(view.rgb, TARGET, device=model.device)
        return 0.3 * weighed(view, TARGET, seen, 1.5) + slope(view) + loss

    ours = result(model, fused)
    for one, again, reference in zip(
        ours, result(model, fused), result(model, torch_only), strict=True
    ):
        assert torch.equal(one, again)
        torch.testing.assert_close(one, reference, rtol=1e-9, atol=1e-12)


def test_a_term_runs_on_the_device_of_the_render(
    model: GaussianModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not on the one that would be chosen, to which the images would be copied."""
    chosen = "core_rasterizer.custom.pixel_term.open_device"
    monkeypatch.setattr(chosen, lambda: pytest.fail("another device"))
    view = rendered(model)
    SLOPE(view=view).backward()
    assert not view.fetched, "no image was read"


def test_tensors_take_part_like_renders(device: Device) -> None:
    images = [noise(5, 7, *rest, seed=9).requires_grad_() for rest in ((3,), ())]
    target = noise(5, 7, 3)

    def of(rgb: Tensor, alpha: Tensor) -> Tensor:
        view = Rendering(rgb, alpha, alpha)
        return WEIGHED(view=view, target=target, seen=None, power=2, device=device)

    torch.autograd.gradcheck(of, images)


def test_of_a_render_only_what_is_declared_gets_a_gradient_and_only_where_it_is_wanted(
    model: GaussianModel,
) -> None:
    with torch.no_grad():
        silent = rendered(model)
    assert not SLOPE(view=silent).requires_grad
    fixed = rendered(model).detach()
    assert float(SLOPE(view=fixed)) == float(SLOPE(view=silent)) > 0


@pytest.mark.parametrize("value", ["NAN", "INFINITY", "1e30f * 1e30f"])
def test_an_undefined_gradient_is_refused_although_the_loss_is_finite(
    model: GaussianModel, value: str
) -> None:
    source = f"d_view_alpha[p] = p == 40 ? {value} : 0; loss += view_alpha[p];"
    term = PixelTerm(source, ["view_alpha"])
    loss = term(view=rendered(model))
    with pytest.raises(ExplainedError, match=r"undefined gradient in 1 values .* 'view_alpha'"):
        loss.backward()


def test_a_weight_that_overflows_is_refused(device: Device) -> None:
    model = GaussianModel(parameters(40), device)
    term = PixelTerm("loss += 1e-30f; d_view_alpha[p] = 10;", ["view_alpha"])
    with pytest.raises(ExplainedError, match="undefined gradient"):
        (3e38 * term(view=rendered(model))).backward()


def test_mistakes_are_explained(device: Device) -> None:
    image = noise(5, 7)
    with pytest.raises(ExplainedError, match="does not name the input 'viwe'"):
        SLOPE(viwe=image)
    with pytest.raises(ExplainedError, match="no image 'view_depth' is given"):
        SLOPE(view=None)
    view = Rendering(noise(5, 7, 3), image, image)
    with pytest.raises(ExplainedError, match=r"'target' has the size \(4, 7\), others \(5, 7\)"):
        WEIGHED(view=view, target=noise(4, 7, 3), seen=None, power=1)
    with pytest.raises(DeviceError, match=r"wobble(?s:.)*correct the source"):
        PixelTerm("loss += image[p] +;", [], name="wobble")(image=image, device=device)
