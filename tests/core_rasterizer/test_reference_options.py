"""Options of the reference renderer."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from core_rasterizer import Camera
from core_rasterizer.reference import project, render
from core_rasterizer.spherical_harmonics import band_weights
from tests.core_rasterizer.scenes import random_camera, random_scene
from tests.core_rasterizer.test_reference import one_gaussian, simple_camera


def test_the_gradient_of_the_pose_agrees_with_finite_differences() -> None:
    """The twelve numbers on their own: the rows need not stay orthogonal."""
    generator = torch.Generator().manual_seed(7)
    scene = random_scene(generator, 3, sh_degree=2, spread=0.4)
    scene.scales += 0.4
    view = random_camera(generator, 6, 5)

    def images(pose: Tensor) -> tuple[Tensor, ...]:
        camera = Camera(pose, view.fx, view.fy, view.cx, view.cy, 6, 5)
        image = render(*scene.tensors(), camera)
        return image.rgb, image.depth, image.alpha

    pose = view.world_to_camera.clone().requires_grad_()
    assert torch.autograd.gradcheck(images, (pose,), eps=1e-7, atol=1e-5, rtol=1e-4)


def test_dilation_widens_the_ellipse_by_itself() -> None:
    scene, camera = one_gaussian(scales=[0.3, 0.1, 0.2]), simple_camera()
    narrow, wide = (project(**scene, camera=camera, dilation=d).covariances for d in (0.0, 1.7))
    added = (wide - narrow)[0].detach()
    torch.testing.assert_close(added, 1.7 * torch.eye(2, dtype=torch.float64))


def test_compensation_preserves_the_mass_of_a_small_gaussian() -> None:
    """A ball a third of a pixel wide, far from every threshold: its sum over pixels is its mass."""
    scene, camera = one_gaussian(scales=[0.03, 0.03, 0.03]), simple_camera()
    variance = (30 * 0.03 / 3) ** 2
    mass = 2 * torch.pi * variance * 0.7
    compensated = render(**scene, camera=camera, dilation=1.0, compensate_dilation=True)
    assert compensated.alpha.sum().item() == pytest.approx(mass, rel=0.1)
    assert render(**scene, camera=camera, dilation=1.0).alpha.sum().item() > 5 * mass
    peak = 0.7 * variance / (variance + 1.0)
    assert compensated.alpha[12, 16].item() == pytest.approx(peak, rel=1e-3)


def test_without_dilation_there_is_nothing_to_compensate() -> None:
    scene, camera = one_gaussian(scales=[0.3, 0.1, 0.2]), simple_camera()
    plain, compensated = (
        render(**scene, camera=camera, dilation=0.0, compensate_dilation=c) for c in (False, True)
    )
    assert torch.equal(plain.rgb, compensated.rgb)


def test_a_smoothed_gaussian_is_a_wider_and_fainter_one() -> None:
    smoothing = torch.tensor([0.4], dtype=torch.float64)
    smoothed = render(
        **one_gaussian(scales=[0.3, 0.3, 0.3]), camera=simple_camera(), smoothing=smoothing
    )
    wider = one_gaussian(scales=[0.5, 0.5, 0.5], opacities=[0.7 * (0.3 / 0.5) ** 3])
    torch.testing.assert_close(smoothed.rgb, render(**wider, camera=simple_camera()).rgb)


def test_no_smoothing_is_the_identity_with_its_gradient() -> None:
    """Also for a disc, whose scale of zero would give a square root without a slope."""
    gradients = []
    for smoothing in (None, torch.zeros(1)):
        scene = one_gaussian(scales=[0.3, 0.2, 0.0])
        image = render(**scene, camera=simple_camera(), smoothing=smoothing)
        image.rgb.square().sum().backward()
        gradients.append([image.rgb.detach(), *(leaf.grad for leaf in scene.values())])
    for plain, unsmoothed in zip(*gradients, strict=True):
        assert torch.equal(plain, unsmoothed)


def test_no_gradient_flows_to_the_smoothing() -> None:
    smoothing = torch.tensor([0.1], requires_grad=True)
    render(**one_gaussian(), camera=simple_camera(), smoothing=smoothing).rgb.sum().backward()
    assert smoothing.grad is None


def test_bands_fade_in_one_after_another() -> None:
    assert band_weights(0, 4).tolist() == [1, 0, 0, 0]
    assert band_weights(1.25, 9).tolist() == [1] * 4 + [0.25] * 5
    assert band_weights(7.5, 16).tolist() == [1] * 16


def test_half_a_band_lies_in_the_middle() -> None:
    """Colour is linear in the coefficients where nothing is clamped at 0."""
    generator = torch.Generator().manual_seed(3)
    scene, camera = random_scene(generator, 30), random_camera(generator)
    scene.sh[:, 0] += 3.0
    without, half, whole = (
        render(*scene.tensors(), camera, sh_degree=d).rgb for d in (1.0, 1.5, 2.0)
    )
    assert (whole - without).abs().max() > 1e-2
    torch.testing.assert_close(half, (without + whole) / 2)
    scene.sh = scene.sh[:, :4]
    torch.testing.assert_close(render(*scene.tensors(), camera).rgb, without)
