"""Build components and steps as the host does, for tests."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import torch

from core_rasterizer import Camera, GaussianModel, Gaussians, open_device
from registry import Component, Context, Scene, Step, View
from registry.testing import step_of
from tests.core_rasterizer.quick_device import quick_device

ComponentType = TypeVar("ComponentType", bound=Component[Any])


def build(component: type[ComponentType], seed: int = 0, /, **settings: object) -> ComponentType:
    """The component with these settings, validated; the run has the seed."""
    return component(component.Settings(**settings), Context("under test", seed, open_device()))


def offered(hook: Callable[..., None]) -> dict[str, type]:
    """What a plugin's hook registers."""
    found: dict[str, type] = {}
    hook(found.__setitem__)
    return found


def some_gaussians(scales: list[float], opacities: list[float]) -> Gaussians:
    """Grey round Gaussians in a row across the view of `step_with`'s camera."""
    count = len(scales)
    positions = torch.zeros(count, 3)
    positions[:, 0] = torch.linspace(-1, 1, count)
    positions[:, 2] = 4
    return Gaussians.from_points(
        positions, torch.full((count, 3), 0.5), torch.tensor(scales), torch.tensor(opacities), 0
    )


def at_depths(*depths: float, scale: float = 0.1, opacity: float = 0.5) -> Gaussians:
    """Grey round Gaussians on the axis of `step_with`'s camera."""
    count = len(depths)
    positions = torch.zeros(count, 3)
    positions[:, 2] = torch.tensor(depths)
    return Gaussians.from_points(
        positions,
        torch.full((count, 3), 0.5),
        torch.full((count,), scale),
        torch.full((count,), opacity),
        0,
    )


def moment_with(
    gaussians: Gaussians, *, iteration: int = 500, extent: float = 1.0, absolute: bool = False
) -> tuple[Step, GaussianModel]:
    """A step after a real render of the Gaussians and a real backward pass against a striped image.

    Args:
        absolute: collect absolute screen gradients too.
    """
    model = GaussianModel(gaussians, quick_device())
    camera = Camera(torch.eye(4), 64, 64, 32, 24, 64, 48)
    image = (torch.arange(64) % 8 < 4).float()[None, :, None].expand(48, 64, 3).contiguous()
    scene = Scene("stripes", (View("stripes", camera, image),), (), (1.0, 10.0))
    rendering = model.render(camera, collect_statistics=True, collect_absolute=absolute)
    ((rendering.rgb - image) ** 2).mean().backward()
    step = step_of(
        model, scene, rendering=rendering, iteration=iteration, iterations=1000, extent=extent
    )
    return step, model


def step_with(gaussians: Gaussians, *, iteration: int = 500, extent: float = 1.0) -> Step:
    """The step of `moment_with`."""
    return moment_with(gaussians, iteration=iteration, extent=extent)[0]
