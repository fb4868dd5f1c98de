from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from core_rasterizer import GaussianModel, open_device
from registry import Step
from registry.testing import step_of, tiny_scene
from stereogs_plugins.appearances.exposure import Exposure
from tests.stereogs_plugins.building import build, some_gaussians


def begun() -> tuple[Exposure, list[Step], tuple[Tensor, ...]]:
    """The component, a step of each training view, and the views' maps."""
    scene = tiny_scene()
    exposure = build(Exposure)
    exposure.begin_training(scene.for_training())
    step = step_of(GaussianModel(some_gaussians([0.1], [0.5]), open_device()), scene)
    steps = [replace(step, sample=replace(step.sample, view=v)) for v in step.scene.train]
    (group,) = exposure.parameters()
    return exposure, steps, tuple(group.tensors)


def image() -> Tensor:
    return torch.rand(5, 7, 3, generator=torch.Generator().manual_seed(0))


def test_it_begins_as_the_identity() -> None:
    exposure, steps, _ = begun()
    for step in steps:
        assert torch.equal(exposure.colors(step, image()), image())


def test_colours_go_through_the_views_affine_map_and_the_mean_map_is_the_identity() -> None:
    exposure, steps, maps = begun()
    draw = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for one in maps:
            one.copy_(torch.randn(3, 4, generator=draw))
    mean = torch.stack(maps).mean(dim=0)
    together = []
    for step, one in zip(steps, maps, strict=True):
        shown = exposure.colors(step, image())
        change = (one - mean).float().detach()
        expected = torch.einsum("ij,hwj->hwi", torch.eye(3) + change[:, :3], image())
        torch.testing.assert_close(shown.detach(), expected + change[:, 3])
        together.append(shown.detach())
    torch.testing.assert_close(torch.stack(together).mean(dim=0), image())


def test_gradients_reach_the_picture_and_the_views_own_map() -> None:
    exposure, steps, maps = begun()
    with torch.no_grad():
        maps[0].copy_(torch.randn(3, 4, generator=torch.Generator().manual_seed(2)))
    rgb = image().double().requires_grad_()
    assert torch.autograd.gradcheck(lambda x: exposure.colors(steps[0], x), (rgb,))
    weights = torch.rand(5, 7, 3, generator=torch.Generator().manual_seed(3)).double()
    (weights * exposure.colors(steps[0], rgb)).sum().backward()
    gradient = maps[0].grad
    assert gradient is not None
    # d/dA_ij = sum of w_i rgb_j, d/db_i = sum of w_i
    expected = torch.einsum("hwi,hwj->ij", weights, rgb.detach())
    torch.testing.assert_close(gradient[:, :3], expected)
    torch.testing.assert_close(gradient[:, 3], weights.sum(dim=(0, 1)))
    assert all(one.grad is None for one in maps[1:])


def test_photographs_of_different_exposure_are_told_apart() -> None:
    """Two photographs of one grey wall, 0.4 and 0.6: the maps explain the difference, the wall stays."""
    exposure, steps, maps = begun()
    adam = torch.optim.Adam(maps, lr=5e-3)
    wall = torch.full((4, 4, 3), 0.5)
    for iteration in range(200):
        index = iteration % 2
        adam.zero_grad(set_to_none=True)
        (exposure.colors(steps[index], wall) - (0.4, 0.6)[index]).square().mean().backward()
        adam.step()
    for index, level in enumerate((0.4, 0.6)):
        shown = exposure.colors(steps[index], wall).detach()
        assert float(shown.mean()) == pytest.approx(level, abs=0.01)
