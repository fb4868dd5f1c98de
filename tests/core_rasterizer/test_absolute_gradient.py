"""Absolute screen gradients against the reference; no effect if not collected."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from core_rasterizer import Camera, Device, GaussianError, GaussianModel, Gaussians
from core_rasterizer.layout import PARAMETERS
from core_rasterizer.optimization import GaussianReader
from tests.core_rasterizer.scenes import parameters, random_camera, with_centers

CAMERA = random_camera(torch.Generator().manual_seed(8), 13, 9)
COUNT = 40


def expected(gaussians: Gaussians, camera: Camera) -> Tensor:
    """Every pixel's own gradient, by autograd in float64, for the loss sum(rgb^2)."""
    projected, centers, image = with_centers(gaussians, camera)
    losses = image.rgb.square().sum(2).reshape(-1)
    pulls = [torch.autograd.grad(loss, centers, retain_graph=True)[0].abs() for loss in losses]
    in_ndc = torch.stack(pulls).sum(0) * torch.tensor([camera.width / 2, camera.height / 2])
    result = torch.zeros(len(gaussians), dtype=torch.float64)
    result[projected.indices] = in_ndc.norm(dim=1)
    return result


def differentiate(model: GaussianModel, *, absolute: bool = True) -> None:
    model.zero_gradients()
    rendering = model.render(CAMERA, collect_statistics=True, collect_absolute=absolute)
    rendering.rgb.square().sum().backward()


def test_is_the_sum_of_absolute_pixel_gradients(device: Device) -> None:
    if not device.supports_double:
        pytest.skip("the device has no double precision")
    gaussians = parameters(COUNT)
    model = GaussianModel(gaussians, device, dtype=torch.float64)
    for _ in range(2):  # the mean over two equal renders is that of one
        differentiate(model)
    wanted = expected(gaussians, CAMERA)
    assert wanted.any()
    found = model.statistics.absolute_screen_gradient()
    torch.testing.assert_close(found, wanted, rtol=0, atol=1e-9 * float(wanted.max()))
    # Where pixels pull against each other the signed one is smaller, and nowhere is it larger.
    signed = model.statistics.screen_gradient()
    assert (signed <= found + 1e-12).all()
    assert (signed < 0.5 * found).any()


def test_results_without_it_are_bit_identical(device: Device) -> None:
    plain, asked = (GaussianModel(parameters(COUNT), device) for _ in range(2))
    differentiate(plain, absolute=False)
    differentiate(asked)
    for name in PARAMETERS:
        assert torch.equal(plain.gradient(name), asked.gradient(name))
    assert torch.equal(plain.statistics.sums(), asked.statistics.sums()[:2])
    assert plain.statistics.sums().shape == (2, COUNT)
    with pytest.raises(GaussianError, match="no render has collected"):
        GaussianReader(plain).absolute_screen_gradient()
    wanted = expected(parameters(COUNT), CAMERA)
    found = asked.statistics.absolute_screen_gradient().double()
    torch.testing.assert_close(found, wanted, rtol=0, atol=2e-5 * float(wanted.max()))


def test_it_is_restored_and_reset(device: Device) -> None:
    model, other = (GaussianModel(parameters(COUNT), device) for _ in range(2))
    differentiate(model)
    other.statistics.restore(model.statistics.sums())
    first = model.statistics.absolute_screen_gradient().clone()
    assert torch.equal(other.statistics.absolute_screen_gradient(), first)
    model.statistics.reset()
    assert not model.statistics.absolute_screen_gradient().any()
    differentiate(model)
    assert torch.equal(GaussianReader(model).absolute_screen_gradient(), first)
