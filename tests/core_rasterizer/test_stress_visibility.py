"""Gaussians that cannot or can barely be seen: missing, behind, at the camera, undefined."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from core_rasterizer import Adam, Device, GaussianModel, Gaussians
from core_rasterizer.layout import PARAMETERS, padded
from core_rasterizer.raster import NEAR_PLANE, pack
from tests.core_rasterizer.scenes import NAMES, parameters, rates
from tests.core_rasterizer.stress import (
    assert_agrees_with_oracle,
    assert_invisible,
    assert_nothing_seen,
    crowd,
    plain_camera,
    there_and_back,
)

RATES = rates(1e-3)


@pytest.mark.parametrize("sh_degree", [0, 3])
def test_no_gaussians_at_all(device: Device, sh_degree: int) -> None:
    """Case 1: N = 0. Background, and empty gradients of the right shapes, spherical harmonics too."""
    rendering, gradients = there_and_back(crowd(0, sh_degree), plain_camera(), device)
    assert_nothing_seen(rendering, gradients)
    assert gradients["sh"].shape == (0, (sh_degree + 1) ** 2, 3)


def test_a_model_without_gaussians_renders_and_steps(device: Device) -> None:
    """Case 1 for the model: render, backward, optimizer and statistics for N = 0."""
    model = GaussianModel(parameters(0), device)
    optimizer = Adam(model)
    rendering = model.render(plain_camera(), collect_statistics=True)
    rendering.rgb.sum().backward()
    optimizer.step(RATES, active_sh_degree=3)
    assert not rendering.rgb.any()
    assert model.gradient("sh").shape == (0, 16, 3)
    assert model.statistics.screen_gradient().shape == (0,)
    assert len(model.gaussians()) == 0


def test_a_model_whose_gaussians_are_all_culled(device: Device) -> None:
    """Case 1 for the model: N > 0, but none in view; no parameter changes."""
    gaussians = parameters(40)
    gaussians.means[:, 2] = -5.0
    model = GaussianModel(gaussians, device)
    before = model.digest()
    model.render(plain_camera(), collect_statistics=True).rgb.sum().backward()
    Adam(model).step(RATES, active_sh_degree=3)
    assert model.digest() == before
    assert not model.statistics.screen_gradient().any()


def test_fewer_pairs_than_tiles(device: Device) -> None:
    """Case 2: one small Gaussian in an image of very many tiles, all others empty."""
    camera = plain_camera(640, 480, focal=600)
    scene = crowd(1)
    scene.means[0] = torch.tensor([0.9, -0.6, 2.0])
    scene.scales[:] = 0.01
    rendering, gradients = there_and_back(scene, camera, device)
    assert 0 < rendering.alpha.count_nonzero() < 2000
    assert all(gradient.any() for gradient in gradients.values())
    assert_agrees_with_oracle(scene, camera, device)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize(
    ("field", "component"),
    [(name, k) for name, size in zip(NAMES, (3, 4, 3, 1, 12), strict=True) for k in range(size)],
)
def test_one_undefined_number_hides_its_gaussian_alone(
    device: Device, field: str, component: int, value: float
) -> None:
    """Case 3: NaN or infinite in any single number of a Gaussian in the middle of the image."""
    scene = crowd()
    getattr(scene, field).reshape(12, -1)[0, component] = value
    assert_invisible(scene, 0, plain_camera(), device)


def test_undefined_logarithms_and_logits_hide_their_gaussian(device: Device) -> None:
    """Case 3 with activations: exp and sigmoid must propagate NaN."""
    scene = crowd(24, sh_degree=0)
    gaussians = Gaussians(
        scene.means, scene.scales.log(), scene.quaternions, torch.logit(scene.opacities), scene.sh
    )
    healthy = GaussianModel(
        Gaussians(**{name: getattr(gaussians, name)[11:] for name in vars(gaussians)}), device
    )
    rows = pack(gaussians, torch.float32, padded(24))
    for row in range(11):
        rows[row, row] = math.nan
    model = GaussianModel(gaussians, device)
    model.adopt(rows, 24)
    images = []
    for engine in (model, healthy):
        rendering = engine.render(plain_camera())
        (rendering.rgb.sum() + rendering.depth.sum()).backward()
        images.append(rendering.rgb.detach())
    assert torch.equal(*images)
    for name in PARAMETERS:
        assert not model.gradient(name)[:11].any(), name
        assert torch.equal(model.gradient(name)[11:], healthy.gradient(name)), name


@pytest.mark.parametrize("log_scale", [88.0, 89.0, 1e10, 3e38])
def test_a_logarithm_of_scale_beyond_exp(device: Device, log_scale: float) -> None:
    """Case 3: exp would overflow. The Gaussian is invisible, and its gradient zero."""
    gaussians = parameters(20)
    gaussians.log_scales[7, 1] = log_scale
    model = GaussianModel(gaussians, device)
    rendering = model.render(plain_camera())
    rendering.rgb.sum().backward()
    assert torch.isfinite(rendering.rgb).all()
    for name in PARAMETERS:
        assert torch.isfinite(model.gradient(name)).all(), name
        assert not model.gradient(name)[7].any(), name


@pytest.mark.parametrize("scale", [0.3, 1e4])
@pytest.mark.parametrize("z", [0.0, -0.0, 1e-30, -1e-30, -1.0, NEAR_PLANE])
def test_at_or_behind_the_camera(device: Device, z: float, scale: float) -> None:
    """Case 7: at the camera's centre (no view direction), in its plane, behind it, on the near plane."""
    scene = crowd()
    scene.means[0] = torch.tensor([0.0, 0.0, z])
    scene.scales[0] = scale
    assert_invisible(scene, 0, plain_camera(), device)


def test_the_near_plane_to_the_last_bit(device: Device) -> None:
    """Case 7: the depth next above the near plane is seen, the near plane and the next below are not."""
    camera = plain_camera()
    near = np.float32(NEAR_PLANE)
    seen = []
    for z in (np.nextafter(near, np.float32(0)), near, np.nextafter(near, np.float32(1))):
        scene = crowd(1)
        scene.means[0] = torch.tensor([0.0, 0.0, float(z)])
        scene.scales[:] = 0.01
        rendering, gradients = there_and_back(scene, camera, device)
        seen.append(bool(rendering.alpha.any()))
        assert gradients["means"].any() == rendering.alpha.any()
    assert seen == [False, False, True]


@pytest.mark.parametrize("sideways", [0.0, 0.3, 30.0])
def test_a_needle_through_the_camera(device: Device, sideways: float) -> None:
    """Case 8: just beyond the near plane and metres long, straight at the viewer and off to the side."""
    scene = crowd()
    scene.means[0] = torch.tensor([sideways, 0.0, NEAR_PLANE * 1.001])
    scene.scales[0] = torch.tensor([0.01, 0.01, 8.0])
    scene.quaternions[0] = torch.tensor([1.0, 0.02, 0.01, 0.0])
    there_and_back(scene, plain_camera(), device)
    assert_agrees_with_oracle(
        scene, plain_camera(), device, torch.float64, image_tolerance=1e-9, gradient_tolerance=1e-7
    )


@pytest.mark.parametrize(
    ("focal", "size", "shift"),
    [
        pytest.param(1.05, 48, 0.0, id="fov-175-degrees"),
        pytest.param(27500.0, 48, 0.0, id="fov-a-tenth-of-a-degree"),
        pytest.param(50.0, 48, 500.0, id="principal-point-ten-images-away"),
        pytest.param(50.0, 48, -30.0, id="principal-point-just-outside"),
    ],
)
def test_extreme_cameras_inside_the_cloud(
    device: Device, focal: float, size: int, shift: float
) -> None:
    """Case 28: Gaussians all around the camera, seen through extreme lenses."""
    generator = torch.Generator().manual_seed(28)
    scene = crowd(60)
    scene.means = 1.5 * torch.randn(60, 3, generator=generator, dtype=torch.float64)
    scene.means[:10] = torch.tensor([-shift / focal * 2, 0.0, 2.0]) + 0.001 * scene.means[:10]
    camera = plain_camera(size, size, focal)
    camera = type(camera)(torch.eye(4), focal, focal, size / 2 + shift, size / 2, size, size)
    rendering, _ = there_and_back(scene, camera, device)
    assert rendering.alpha.any()
    assert_agrees_with_oracle(
        scene, camera, device, torch.float64, image_tolerance=1e-8, gradient_tolerance=1e-6
    )


def test_depths_of_ten_thousand_and_more(device: Device) -> None:
    """Case 36: a far scene keeps its relative accuracy in float32."""
    for depth in (1e4, 1e6):
        scene = crowd(30)
        scene.means, scene.scales = scene.means * depth, scene.scales * depth
        assert_agrees_with_oracle(scene, plain_camera(), device)
