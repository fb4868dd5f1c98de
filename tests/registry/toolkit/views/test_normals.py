"""Normals of rendered depth and of Gaussians."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from core_rasterizer import Camera, GaussianModel, GaussianReader, Gaussians, Rendering, open_device
from registry.toolkit.views import axis_normals, blended_normals, depth_normals

CAMERA = Camera.centered(torch.eye(4), 20, 24, 16)
TURNED = Camera.look_at((0.5, -1, 0), (0, 0, 3), 20, 24, 16)
TILT = 0.6
WALL = torch.tensor([math.sin(TILT), 0.0, -math.cos(TILT)], dtype=torch.float64)
"""Normal of a wall through (0, 0, 4), towards the origin."""


def wall(camera: Camera) -> Tensor:
    """Return the z-depth of the wall, `[H, W]` float64, and its normal in the camera's axes."""
    u, v = camera.pixel_centers()
    near, far = (camera.unproject(u, v, torch.full_like(u, z)) for z in (1.0, 2.0))
    towards = (far - near) @ WALL
    return 1 + ((torch.tensor([0.0, 0, 4]).double() - near) @ WALL) / towards


@pytest.mark.parametrize("camera", [CAMERA, TURNED], ids=["ahead", "turned"])
def test_depth_of_a_plane_has_its_normal_except_beside_what_is_transparent(camera: Camera) -> None:
    alpha = torch.full((16, 24), 0.8, dtype=torch.float64)
    alpha[5, 7] = 0.3
    rendering = Rendering(torch.zeros(16, 24, 3), wall(camera) * alpha, alpha)
    normals = depth_normals(rendering, camera)
    known = normals.any(dim=2)
    expected = camera.world_to_camera[:3, :3] @ WALL
    torch.testing.assert_close(normals[known], expected.expand(int(known.sum()), 3))
    assert not known[[0, -1]].any()
    assert not known[:, [0, -1]].any()
    unknown = (~known[1:-1, 1:-1]).nonzero() + 1
    assert unknown.tolist() == [[4, 7], [5, 6], [5, 7], [5, 8], [6, 7]]


def flat(camera: Camera, thickness: float = 0.01) -> list[Tensor]:
    """Return means, quaternions, scales and opacities of a wall of discs that are thin along their y axis."""
    u, v = camera.pixel_centers()
    means = camera.unproject(u, v, wall(camera)).reshape(-1, 3)
    scales = torch.tensor([0.3, thickness, 0.3]).double().expand(len(means), 3)
    # From the y axis to the normal, the long way: the sign of a Gaussian's axis is arbitrary.
    axis = torch.linalg.cross(torch.tensor([0.0, 1, 0]).double(), -WALL)
    half = math.pi / 4
    quaternion = torch.cat([torch.tensor([math.cos(half)]).double(), math.sin(half) * axis])
    opacities = torch.full((len(means),), 0.9, dtype=torch.float64)
    return [means, quaternion.expand(len(means), 4), scales, opacities]


@pytest.mark.parametrize("camera", [CAMERA, TURNED], ids=["ahead", "turned"])
def test_flat_gaussians_have_the_normal_of_their_smallest_axis(camera: Camera) -> None:
    means, quaternions, scales, opacities = (x.float() for x in flat(camera))
    gaussians = Gaussians(
        means, scales.log(), quaternions, torch.logit(opacities), torch.zeros(len(means), 1, 3)
    )
    model = GaussianModel(gaussians, open_device())
    normals = axis_normals(GaussianReader(model), camera)
    alpha = model.render(camera).alpha.detach()
    expected = (camera.world_to_camera[:3, :3] @ WALL).float()
    torch.testing.assert_close(normals.detach(), alpha[..., None] * expected, atol=1e-4, rtol=0)
    normals[..., 0].sum().backward()
    assert model.gradient("quaternions").any()


def test_gradients_are_those_of_finite_differences() -> None:
    device = open_device()
    if not device.supports_double:
        pytest.skip("the device has no double precision")
    generator = torch.Generator().manual_seed(1)

    def random(*shape: int) -> Tensor:
        return torch.rand(*shape, generator=generator, dtype=torch.float64)

    depth, alpha = 2 + random(4, 5), 0.6 + 0.4 * random(4, 5)
    small = Camera.centered(torch.eye(4), 5, 5, 4)

    def of_depth(depth: Tensor, alpha: Tensor) -> Tensor:
        return depth_normals(Rendering(torch.zeros(4, 5, 3), depth, alpha), small)

    torch.autograd.gradcheck(of_depth, (depth.requires_grad_(), alpha.requires_grad_()))
    means = (random(3, 3) - 0.5) + torch.tensor([0.0, 0, 6]).double()
    scales = 3 + torch.tensor([[0.0, 1, 2], [1, 0, 2], [2, 1, 0]]).double()
    leaves = [means, random(3, 4) - 0.5, scales, 0.2 + 0.3 * random(3)]
    for leaf in leaves:
        leaf.requires_grad_()

    def of_axes(means: Tensor, quaternions: Tensor, scales: Tensor, opacities: Tensor) -> Tensor:
        return blended_normals(means, quaternions, scales, opacities, small, device=device)

    torch.autograd.gradcheck(of_axes, leaves)
