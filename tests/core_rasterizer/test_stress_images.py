"""Images and losses at their limits: empty pixels, overflow, NaN, invalid arguments."""

from __future__ import annotations

import math

import pytest
import torch

from core_rasterizer import (
    CameraError,
    Device,
    ExplainedError,
    GaussianError,
    GaussianModel,
    photometric_loss,
    rasterize,
)
from tests.core_rasterizer.scenes import parameters
from tests.core_rasterizer.stress import crowd, plain_camera, there_and_back

UNDEFINED = [math.nan, math.inf, -math.inf]


def test_depth_where_nothing_was_hit(device: Device) -> None:
    """Case 17: depth is 0 where alpha is 0, and the usual ratio of both has a finite gradient."""
    scene = crowd(3)
    scene.scales[:] = 0.05
    leaves = scene.tensors(torch.float32)
    rendering = rasterize(*leaves, plain_camera(), device=device)
    empty = rendering.alpha == 0
    assert empty.any()
    assert not rendering.depth[empty].any()
    (rendering.depth / rendering.alpha.clamp(min=1e-8)).sum().backward()
    for leaf in leaves:
        assert leaf.grad is not None
        assert torch.isfinite(leaf.grad).all()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("size", [(1, 1), (1, 7), (10, 10), (11, 11), (12, 5)])
@pytest.mark.parametrize("level", [0.0, 1e-30, 0.5, 1.0, 1e4])
def test_ssim_of_constant_images(
    device: Device, size: tuple[int, int], level: float, dtype: torch.dtype
) -> None:
    """Case 20: no texture at all, in images smaller than the window too. Equal images lose nothing."""
    rgb = torch.full((*size, 3), level, dtype=dtype, requires_grad=True)
    equal = photometric_loss(rgb, rgb.detach().clone(), 1.0, device=device)
    equal.backward()
    assert equal.item() == 0
    assert rgb.grad is not None
    assert not rgb.grad.any()
    other = photometric_loss(rgb, torch.full_like(rgb, 0.25), 0.2, device=device)
    other.backward()
    assert math.isfinite(other.item())
    assert torch.isfinite(rgb.grad).all()


@pytest.mark.parametrize("value", UNDEFINED)
@pytest.mark.parametrize("name", ["rgb", "target"])
def test_an_undefined_pixel_is_named_by_the_loss(device: Device, name: str, value: float) -> None:
    """Case 18 for the photometric loss: an error with image and index, never NaN."""
    images = {name: torch.rand(9, 13, 3) for name in ("rgb", "target")}
    images[name][4, 7, 1] = value
    with pytest.raises(ExplainedError, match="not finite") as error:
        photometric_loss(images["rgb"], images["target"], device=device)
    assert error.value.where == f"photometric_loss: {name}[4, 7, 1]"


@pytest.mark.parametrize("size", [1e3, 1e9, 1e13, 1e17, 1e19, 1e37])
def test_a_loss_of_huge_images_is_finite_or_raises(device: Device, size: float) -> None:
    """Case 18: products overflow on the way; what comes out is a number with a finite gradient."""
    generator = torch.Generator().manual_seed(18)
    rgb = (size * torch.rand(20, 20, 3, generator=generator)).requires_grad_()
    target = torch.rand(20, 20, 3, generator=generator)
    if size > 1e20:  # its square is no float
        with pytest.raises(ExplainedError, match="overflow"):
            photometric_loss(rgb, target, device=device)
        return
    loss = photometric_loss(rgb, target, device=device)
    loss.backward()
    assert math.isfinite(loss.item())
    assert rgb.grad is not None
    assert torch.isfinite(rgb.grad).all()


@pytest.mark.parametrize("name", ["rgb", "depth", "alpha"])
@pytest.mark.parametrize("value", UNDEFINED)
def test_an_undefined_image_gradient_is_named(device: Device, name: str, value: float) -> None:
    """Case 15: a custom loss gives NaN. The error names it, and no parameter changes."""
    model = GaussianModel(parameters(20), device)
    image = getattr(model.render(plain_camera()), name)
    weights = torch.ones_like(image)
    weights[3, 5] = value
    with pytest.raises(ExplainedError, match="undefined gradient") as error:
        (image * weights).sum().backward()
    assert f"{name}[3, 5" in error.value.where
    assert not model.gradient("means").any()
    model.render(plain_camera()).rgb.sum().backward()
    assert model.gradient("means").any()


@pytest.mark.parametrize("size", [1e20, 1e37, 3e38])
def test_a_gradient_that_overflows_becomes_zero(device: Device, size: float) -> None:
    """Case 15: image gradients so large that the chain rule leaves the numbers."""
    scene = crowd()
    leaves = scene.tensors(torch.float32)
    rendering = rasterize(*leaves, plain_camera(), device=device)
    rendering.rgb.backward(torch.full_like(rendering.rgb, size))
    for leaf in leaves:
        assert leaf.grad is not None
        assert torch.isfinite(leaf.grad).all()


@pytest.mark.parametrize("value", [*UNDEFINED, 1e38])
@pytest.mark.parametrize("index", [0, 2])
def test_an_undefined_background_is_named(device: Device, index: int, value: float) -> None:
    background = [0.5, 0.5, 0.5]
    background[index] = value
    model = GaussianModel(parameters(5), device)
    with pytest.raises(GaussianError) as error:
        model.render(plain_camera(), background=background)
    assert (error.value.field, error.value.index) == ("background", index)
    with pytest.raises(GaussianError, match="expected 3"):
        model.render(plain_camera(), background=(0.5, 0.5))


@pytest.mark.parametrize("near", [*UNDEFINED, 0.0, -1.0, 1e38])
def test_a_near_plane_that_is_not_in_front_is_named(device: Device, near: float) -> None:
    model = GaussianModel(parameters(5), device)
    with pytest.raises(CameraError, match="near plane") as error:
        model.render(plain_camera(), near=near)
    assert error.value.where == "near"


def test_factors_and_degrees_that_do_not_fit_are_named(device: Device) -> None:
    model = GaussianModel(parameters(5), device)
    with pytest.raises(GaussianError) as error:
        model.render(plain_camera(), opacity_scale=torch.ones(4))
    assert error.value.field == "opacity_scale"
    with pytest.raises(GaussianError) as error:
        model.render(plain_camera(), sh_degree=-1)
    assert error.value.field == "sh_degree"


def test_colours_below_zero_are_black_and_have_no_gradient(device: Device) -> None:
    """Case 27: the clamp of one channel does not stop the gradient of the others."""
    scene = crowd(1)
    scene.sh[:] = 0
    scene.sh[0, 0] = torch.tensor([-5.0, 0.3, 0.3])
    rendering, gradients = there_and_back(scene, plain_camera(), device)
    middle = rendering.rgb[18, 24], rendering.alpha[18, 24]
    assert torch.allclose(middle[0][0], (1 - middle[1]) * 0.2, atol=1e-6)
    assert not gradients["sh"][0, :, 0].any()
    assert gradients["sh"][0, 0, 1:].all()


@pytest.mark.parametrize("stored", [0, 1, 2, 3])
def test_degree_zero_in_any_storage(device: Device, stored: int) -> None:
    """Case 27: bands that are stored but not used play no part, whatever they hold; nor do missing ones."""
    gaussians = parameters(30, sh_degree=stored)
    constant = type(gaussians)(**(vars(gaussians) | {"sh": gaussians.sh[:, :1].clone()}))
    gaussians.sh[:, 1:] = 3e38
    results = []
    for given in (gaussians, constant):
        model = GaussianModel(given, device)
        rendering = model.render(plain_camera(), sh_degree=0)
        rendering.rgb.square().sum().backward()
        results.append((rendering.rgb.detach(), model.gradient("means"), model.gradient("sh")))
    assert torch.equal(results[0][0], results[1][0])
    assert torch.equal(results[0][1], results[1][1])
    assert torch.equal(results[0][2][:, :1], results[1][2])
    assert not results[0][2][:, 1:].any()
    with torch.no_grad():
        more = GaussianModel(constant, device).render(plain_camera(), sh_degree=3)
    assert torch.equal(more.rgb, results[1][0])


def test_the_size_of_a_small_image_on_the_smallest_grid(device: Device) -> None:
    """Cases 20 and 23 together: one pixel, rendered, compared and differentiated."""
    model = GaussianModel(parameters(20), device)
    rendering = model.render(plain_camera(1, 1))
    photometric_loss(rendering.rgb, torch.zeros(1, 1, 3), device=device).backward()
    assert rendering.rgb.shape == (1, 1, 3)
    assert torch.isfinite(model.gradient("means")).all()
    assert model.gradient("means").any()
