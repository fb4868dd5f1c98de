"""All options of a render, for tests that combine them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from core_rasterizer import Camera


def posed(camera: Camera) -> tuple[Camera, Tensor]:
    """The same camera, and the leaf that its pose is a copy of."""
    pose = camera.world_to_camera.detach().clone().requires_grad_()
    return replace(camera, world_to_camera=pose), pose


def smoothing_of(generator: torch.Generator, count: int, largest: float = 0.3) -> Tensor:
    """Standard deviations `[count]` from 0 to `largest`, every fifth of them 0."""
    values = largest * torch.rand(count, generator=generator, dtype=torch.float64)
    values[::5] = 0
    return values


def all_options(generator: torch.Generator, count: int) -> dict[str, Any]:
    """Keyword arguments of `rasterize` and of `reference.render`."""
    return {
        "sh_degree": 1.4,
        "dilation": 0.1,
        "compensate_dilation": True,
        "smoothing": smoothing_of(generator, count),
    }
