"""Opacity at its thresholds, transmittance that runs out, and factors that drop Gaussians."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from core_rasterizer import Device, GaussianModel, Gaussians
from core_rasterizer.layout import PARAMETERS
from tests.core_rasterizer.scenes import Scene, parameters
from tests.core_rasterizer.stress import (
    assert_agrees_with_oracle,
    assert_invisible,
    assert_nothing_seen,
    crowd,
    plain_camera,
    there_and_back,
)

CUT = np.float32(1 / 255)


@pytest.mark.parametrize("opacity", [0.99, 1.0, 1.5, 30.0])
def test_opaque_and_beyond(device: Device, opacity: float) -> None:
    """Case 11: at and above the clamp of alpha, where its gradient ends."""
    scene = crowd()
    scene.opacities[::2] = opacity
    assert_agrees_with_oracle(scene, plain_camera(), device, torch.float64, 1e-9, 1e-7)
    _, gradients = there_and_back(scene, plain_camera(), device)
    assert torch.isfinite(gradients["opacities"]).all()


@pytest.mark.parametrize("opacity", [0.0, -0.0, 1e-45, 1e-30, -0.5, -math.inf])
def test_zero_opacity_is_invisible(device: Device, opacity: float) -> None:
    """Cases 11 and 12: zero, denormal, negative. No logarithm or root of a negative number."""
    scene = crowd()
    scene.opacities[0] = opacity
    assert_invisible(scene, 0, plain_camera(), device)


@pytest.mark.parametrize("logit", [-1e30, -100.0, -88.0, 88.0, 100.0, 1e30])
def test_logits_beyond_the_range_of_exp(device: Device, logit: float) -> None:
    """Case 11: sigmoid saturates at 0 and 1 without overflow, and so does its slope."""
    gaussians = parameters(30)
    gaussians.opacity_logits[::3] = logit
    model = GaussianModel(gaussians, device)
    rendering = model.render(plain_camera())
    (rendering.rgb.sum() + rendering.depth.sum()).backward()
    assert torch.isfinite(rendering.rgb).all()
    gradient = model.gradient("opacity_logits")
    assert torch.isfinite(gradient).all()
    assert gradient[::3].abs().max() < 1e-30
    assert gradient[1::3].any()


def test_the_cut_off_to_the_last_bit(device: Device) -> None:
    """Case 12: an opacity one step below 1/255 is culled; from there on the centre pixel decides."""
    camera = plain_camera(17, 17)
    shown = []
    for opacity in (np.nextafter(CUT, np.float32(0)), CUT, np.nextafter(CUT, np.float32(1)), 0.004):
        scene = crowd(1)
        scene.scales[:] = 0.5
        scene.opacities[:] = float(opacity)
        rendering, gradients = there_and_back(scene, camera, device)
        shown.append(bool(rendering.alpha.any()))
        assert bool(gradients["opacities"].any()) == shown[-1]
    assert shown[0] is False
    assert shown[-1] is True


def test_opacities_that_drift_below_the_cut_off(device: Device) -> None:
    """Case 12: a decay takes every Gaussian through 1/255, some in each render."""
    model = GaussianModel(parameters(60), device)
    counts = []
    for _ in range(60):
        model.zero_gradients()
        rendering = model.render(plain_camera())
        (rendering.rgb.sum() + rendering.depth.sum()).backward()
        assert torch.isfinite(rendering.rgb).all()
        assert torch.isfinite(model.gradient("opacity_logits")).all()
        counts.append(int(model.gradient("opacity_logits").count_nonzero()))
        model.write("opacity_logits", model.read("opacity_logits") - 0.2)
    assert counts[0] > 20
    assert counts[-1] == 0


def test_support_collapse(device: Device) -> None:
    """Case 14: a Gaussian just above the cut-off whose centre lies between pixels has no fragment.

    It is in front of the camera and in the image, and still has no gradient and is counted as unseen.
    """
    scene = crowd(20, sh_degree=0)
    scene.scales[:] = 0.001
    gaussians = Gaussians(
        scene.means,
        scene.scales.log(),
        scene.quaternions,
        torch.logit(torch.full((20,), 0.00393)),
        scene.sh,
    )
    gaussians.means[:, :2] = 0.0  # the corner of four pixels
    model = GaussianModel(gaussians, device)
    rendering = model.render(plain_camera(), collect_statistics=True)
    rendering.rgb.sum().backward()
    assert not rendering.alpha.any()
    assert not model.gradient("opacity_logits").any()
    assert not model.statistics.sums().any()


@pytest.mark.parametrize(
    ("layers", "opacity"), [(10_000, 0.98), (3_000, 0.5), (3_000, 0.005), (1_000, 1 / 254.9)]
)
def test_ten_thousand_layers_in_a_pixel(device: Device, layers: int, opacity: float) -> None:
    """Case 24: transmittance runs out at once, soon, late, or never quite; forward and backward."""
    camera = plain_camera(5, 4)
    generator = torch.Generator().manual_seed(24)
    scene = Scene(
        means=torch.zeros(layers, 3, dtype=torch.float64),
        quaternions=torch.tensor([[1.0, 0, 0, 0]], dtype=torch.float64).repeat(layers, 1),
        scales=torch.full((layers, 3), 2.0, dtype=torch.float64),
        opacities=torch.full((layers,), opacity, dtype=torch.float64),
        sh=torch.randn(layers, 1, 3, generator=generator, dtype=torch.float64),
    )
    mixed = torch.randperm(layers, generator=generator)
    scene.means[:, 2] = torch.linspace(2.0, 4.0, layers)[mixed]
    rendering, _ = there_and_back(scene, camera, device)
    assert rendering.alpha.max() <= 1
    assert_agrees_with_oracle(
        scene, camera, device, torch.float64, image_tolerance=1e-9, gradient_tolerance=1e-8
    )
    assert_agrees_with_oracle(scene, camera, device, image_tolerance=2e-4, gradient_tolerance=2e-2)


def factors_applied(device: Device, factor: float) -> tuple[torch.Tensor, GaussianModel]:
    model = GaussianModel(parameters(40), device)
    rendering = model.render(
        plain_camera(), background=(0.1, 0.2, 0.3), opacity_scale=torch.full((40,), factor)
    )
    (rendering.rgb.sum() + rendering.depth.sum()).backward()
    assert torch.isfinite(rendering.rgb).all()
    for name in PARAMETERS:
        assert torch.isfinite(model.gradient(name)).all(), name
    return rendering.rgb.detach(), model


@pytest.mark.parametrize("factor", [0.0, -0.0, -1.0, 1e-30, math.nan, math.inf, 1e38])
def test_factors_that_drop_every_gaussian(device: Device, factor: float) -> None:
    """Case 32: all dropped, or invalid factors. Background without gradient."""
    image, model = factors_applied(device, factor)
    assert torch.equal(image, torch.tensor([0.1, 0.2, 0.3]).expand_as(image))
    assert not model.gradient("opacity_logits").any()


@pytest.mark.parametrize("probability", [0.0, 0.5, 1 - 1e-7])
def test_the_compensation_of_dropout(device: Device, probability: float) -> None:
    """Case 32: kept opacities are divided by 1 - p, which may take them far above 1."""
    image, model = factors_applied(device, 1 / (1 - probability))
    with torch.no_grad():
        plain = model.render(plain_camera(), background=(0.1, 0.2, 0.3)).rgb
    assert torch.equal(image, plain) == (probability == 0)
    if probability > 0.9:  # every touched alpha is at the clamp
        assert model.gradient("opacity_logits").count_nonzero() < 40


def test_all_dropped_then_none(device: Device) -> None:
    """Case 32: an empty render between two others leaves no trace."""
    model = GaussianModel(parameters(40), device)
    images = []
    for factors in (None, torch.zeros(40), None):
        model.zero_gradients()
        rendering = model.render(plain_camera(), opacity_scale=factors)
        rendering.rgb.sum().backward()
        images.append((rendering.rgb.detach(), model.gradient("means").clone()))
    assert all(torch.equal(first, last) for first, last in zip(images[0], images[2], strict=True))
    assert not images[1][1].any()


def test_a_transparent_scene(device: Device) -> None:
    """Cases 1 and 12: all opacities exactly 0."""
    scene = crowd()
    scene.opacities[:] = 0
    assert_nothing_seen(*there_and_back(scene, plain_camera(), device))
