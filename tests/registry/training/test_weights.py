"""Weights of pixels in the photometric loss, against the same formula in float64."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor
from torch.nn.functional import conv2d

from core_rasterizer import Device, Model
from registry import PluginError, Step
from registry.testing import step_of, tiny_scene
from registry.training.gradients import photometric_term
from registry.training.initial_model import initial_gaussians, new_model
from tests.host import TrainingSettings, check_sample

SETTINGS = TrainingSettings(iterations=10, sh_degree=0)


@pytest.fixture
def model(device: Device) -> Model:
    points = tiny_scene().points
    assert points is not None
    return new_model(initial_gaussians(points, SETTINGS), SETTINGS, device)


@pytest.fixture
def step(model: Model) -> Step:
    return step_of(model, tiny_scene())


def loss(rgb: Tensor, target: Tensor) -> Tensor:
    """0.8 L1 + 0.2 D-SSIM as in 3DGS."""
    offsets = torch.arange(-5, 6).double()
    window = torch.exp(-(offsets**2) / (2 * 1.5**2))
    kernel = torch.outer(window, window).expand(3, 1, 11, 11) / window.sum() ** 2

    def mean(image: Tensor) -> Tensor:
        return conv2d(image, kernel, padding=5, groups=3)

    x, y = (image.permute(2, 0, 1)[None] for image in (rgb, target))
    covariance = mean(x * y) - mean(x) * mean(y)
    variances = mean(x * x) - mean(x) ** 2 + mean(y * y) - mean(y) ** 2
    ssim = (2 * mean(x) * mean(y) + 0.01**2) * (2 * covariance + 0.03**2)
    ssim = ssim / (mean(x) ** 2 + mean(y) ** 2 + 0.01**2) / (variances + 0.03**2)
    return 0.8 * (x - y).abs().mean() + 0.2 * (1 - ssim.mean())


def term(
    model: Model, step: Step, rgb: Tensor, target: Tensor, weights: Tensor | None
) -> tuple[Tensor, Tensor]:
    """The loss of the host, and its gradient."""
    shown = rgb.float().requires_grad_()
    sample = replace(step.sample, target=target.float(), weights=weights)
    value = photometric_term(SETTINGS, shown, replace(step, sample=sample), model).value
    value.backward()
    assert shown.grad is not None
    return value.detach(), shown.grad


def images(step: Step) -> tuple[Tensor, Tensor, Tensor]:
    generator = torch.Generator().manual_seed(0)
    shape = step.sample.target.shape
    rgb, target = (torch.rand(shape, generator=generator) for _ in range(2))
    weights = torch.rand(shape[:2], generator=generator).mul(3).sub(1).clamp(0, 1)
    return rgb, target, weights


def test_weights_scale_loss_and_gradient_as_in_float64(model: Model, step: Step) -> None:
    rgb, target, weights = images(step)
    exact, fixed, share = rgb.double().requires_grad_(), rgb.double(), weights.double()[..., None]
    expected = loss(fixed + share * (exact - fixed), fixed + share * (target.double() - fixed))
    expected.backward()
    value, gradient = term(model, step, rgb, target, weights)
    torch.testing.assert_close(value.double(), expected.detach(), rtol=1e-5, atol=0)
    assert exact.grad is not None
    torch.testing.assert_close(gradient.double(), exact.grad, rtol=1e-3, atol=1e-7)
    assert (weights == 0).any()
    assert not gradient[weights == 0].any()


def test_colours_of_excluded_pixels_change_no_bit(model: Model, step: Step) -> None:
    rgb, target, weights = images(step)
    other = torch.where(weights[..., None] == 0, 1 - target, target)
    for first, second in zip(
        *(term(model, step, rgb, t, weights) for t in (target, other)), strict=True
    ):
        assert torch.equal(first, second)


def test_full_weights_are_as_none(model: Model, step: Step) -> None:
    rgb, target, weights = images(step)
    full = term(model, step, rgb, target, torch.ones_like(weights))
    for first, second in zip(full, term(model, step, rgb, target, None), strict=True):
        assert torch.equal(first, second)


def test_a_sampler_that_forgets_the_weights_is_refused(step: Step) -> None:
    ones = torch.ones(step.sample.target.shape[:2])
    given = replace(step.sample, weights=ones)
    smaller = given.camera.resized(given.camera.width // 2, given.camera.height // 2)
    target = given.target[: smaller.height, : smaller.width].contiguous()
    with pytest.raises(PluginError, match="the weights are"):
        check_sample(replace(given, camera=smaller, target=target), step, given)
    with pytest.raises(PluginError, match="the weights of the one before"):
        check_sample(replace(given, view=step.scene.train[1]), step, given)
    check_sample(replace(given, view=step.scene.train[1], weights=0.5 * ones), step, given)
    with pytest.raises(PluginError, match="outside"):
        check_sample(replace(given, weights=2 * ones), step, given)
