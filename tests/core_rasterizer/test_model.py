"""Gaussians on a device: agreement with `rasterize`, accumulation, statistics."""

from __future__ import annotations

import pytest
import torch

from core_rasterizer import (
    Adam,
    Camera,
    Device,
    GaussianError,
    GaussianModel,
    Gaussians,
    rasterize,
)
from core_rasterizer.layout import PARAMETERS
from tests.core_rasterizer.scenes import (
    activated,
    gradients_of,
    leaves_of,
    parameters,
    rates,
    view,
    with_centers,
)


def test_parameters_round_trip(device: Device) -> None:
    gaussians = parameters()
    model = GaussianModel(gaussians, device)
    for name in PARAMETERS:
        assert torch.equal(model.read(name), getattr(gaussians, name)), name
        assert torch.equal(getattr(model.gaussians(), name), getattr(gaussians, name)), name


def test_agrees_with_the_function_through_the_activations(device: Device) -> None:
    """Torch differentiates exp and sigmoid around `rasterize`; the model does it in its kernels."""
    gaussians, camera = parameters(), view()
    model = GaussianModel(gaussians, device)
    leaves = leaves_of(gaussians)
    single = activated(leaves, torch.float32)
    plain = rasterize(*single, camera, (0.1, 0.2, 0.3), device=device)
    resident = model.render(camera, background=(0.1, 0.2, 0.3))
    assert torch.allclose(plain.rgb, resident.rgb, atol=2e-6)
    for rendering in (plain, resident):
        (rendering.rgb.square().sum() + rendering.depth.sum() + rendering.alpha.sum()).backward()
    for name, leaf in vars(leaves).items():
        gradient = model.gradient(name)
        assert (gradient - leaf.grad).abs().max() <= 5e-5 * leaf.grad.abs().max(), name


def test_several_renders_accumulate_and_zeroing_forgets(device: Device) -> None:
    model = GaussianModel(parameters(), device)
    separate = []
    for seed in (1, 2):
        model.zero_gradients()
        model.render(view(seed)).rgb.sum().backward()
        separate.append(gradients_of(model))
    model.zero_gradients()
    (model.render(view(1)).rgb.sum() + model.render(view(2)).rgb.sum()).backward()
    for name in PARAMETERS:
        total = separate[0][name] + separate[1][name]
        assert torch.allclose(
            model.gradient(name), total, rtol=1e-4, atol=float(1e-4 * total.abs().max())
        )
    model.zero_gradients()
    assert not model.gradient("means").any()


def test_touched_gaussians_contribute_to_a_pixel(device: Device) -> None:
    camera = Camera(torch.eye(4), 40, 40, 16, 16, 32, 32)
    gaussians = Gaussians.from_points(
        torch.tensor([[0.0, 0.0, 2.0], [0.0, 0.0, -2.0], [9.0, 0.0, 2.0], [0.0, 0.0, 3.0]]),
        torch.full((4, 3), 0.5),
        torch.tensor([0.05, 0.05, 0.05, 100.0]),
        torch.tensor([0.5, 0.5, 0.5, 0.9999]),
        0,
    )
    model = GaussianModel(gaussians, device)
    model.render(camera).rgb.sum().backward()
    # The last one is opaquer than a pixel lets it be: visible, though its opacity has no gradient.
    assert model.gradient("opacity_logits")[3] == 0
    assert model.touched().tolist() == [True, False, False, True]
    model.zero_gradients()
    assert not model.touched().any()


def test_a_lower_degree_leaves_no_old_gradient_in_higher_bands(device: Device) -> None:
    model = GaussianModel(parameters(), device)
    model.render(view()).rgb.sum().backward()
    assert model.gradient("sh")[:, 4:].any()
    model.zero_gradients()
    model.render(view(), sh_degree=1).rgb.sum().backward()
    assert model.gradient("sh")[:, :4].any()
    assert not model.gradient("sh")[:, 4:].any()


def test_opacity_factors_act_on_the_activated_opacity(device: Device) -> None:
    model = GaussianModel(parameters(), device)
    factors = torch.rand(model.count)
    factors[::3] = 0
    with torch.no_grad():
        scaled = model.render(view(), opacity_scale=factors)
    means, quaternions, scales, opacities, sh = activated(model.gaussians(), torch.float32)
    plain = rasterize(means, quaternions, scales, opacities * factors, sh, view(), device=device)
    assert torch.allclose(scaled.rgb, plain.rgb, atol=3e-6)


def test_screen_gradients_are_the_oracles_in_ndc(device: Device) -> None:
    gaussians, camera = parameters(40), view()
    projected, centers, image = with_centers(gaussians, camera)
    image.rgb.square().sum().backward()
    assert centers.grad is not None
    in_ndc = centers.grad * torch.tensor([camera.width / 2, camera.height / 2])
    expected = torch.zeros(40, dtype=torch.float64)
    expected[projected.indices] = in_ndc.norm(dim=1)

    model = GaussianModel(gaussians, device)
    for _ in range(2):  # the mean over two equal renders is that of one
        model.zero_gradients()
        model.render(camera, collect_statistics=True).rgb.square().sum().backward()
    assert torch.allclose(
        model.statistics.screen_gradient().double(), expected, atol=float(2e-5 * expected.max())
    )
    model.statistics.reset()
    assert not model.statistics.screen_gradient().any()


def test_without_gradients_nothing_is_kept(device: Device) -> None:
    model = GaussianModel(parameters(), device)
    with torch.no_grad():
        rendering = model.render(view())
    assert not rendering.rgb.requires_grad


def test_equal_parameters_have_equal_digests(device: Device) -> None:
    one, other = GaussianModel(parameters(), device), GaussianModel(parameters(), device)
    assert one.digest() == other.digest()
    moved = other.read("means").clone()
    moved[3, 1] += 1e-6
    other.write("means", moved)
    assert one.digest() != other.digest()


def test_backward_after_an_edit_raises(device: Device) -> None:
    model = GaussianModel(parameters(), device)
    rendering = model.render(view())
    model.adopt(model.parameters.read().clone(), model.count)
    with pytest.raises(GaussianError, match="between a render and its backward"):
        rendering.rgb.sum().backward()


def test_backward_after_a_step_raises(device: Device) -> None:
    """As torch does: the gradient would mix the render's values with new ones."""
    model = GaussianModel(parameters(), device)
    first, second = model.render(view()), model.render(view())
    second.rgb.sum().backward()
    Adam(model).step(rates(1e-3), 0)
    with pytest.raises(GaussianError, match="stepped between a render and its backward"):
        first.rgb.sum().backward()


def test_undefined_parameters_and_unknown_names_raise(device: Device) -> None:
    gaussians = parameters()
    gaussians.sh[17, 0, 1] = float("nan")
    with pytest.raises(GaussianError, match="not finite") as error:
        GaussianModel(gaussians, device)
    assert (error.value.field, error.value.index) == ("sh", 17)
    model = GaussianModel(parameters(), device)
    with pytest.raises(GaussianError, match="unknown parameter"):
        model.read("opacity")
    with pytest.raises(GaussianError, match="expected"):
        model.write("means", torch.zeros(3, 3))
