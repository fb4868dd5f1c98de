"""One picture for a visitor: colours, depth or alpha, of the Gaussians that are switched on."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from core_rasterizer import Camera, Rendering
from registry.toolkit.drawing import depth_picture, to_bytes

from .subject import Subject

Channel = Literal["colours", "depth", "alpha"]
CHANNELS: tuple[Channel, ...] = get_args(Channel)


@dataclass(frozen=True)
class Box:
    """An axis-aligned box: its lowest and its highest corner, world units."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]


@dataclass(frozen=True)
class Look:
    """What a visitor has chosen.

    Args:
        channel: what is shown of each pixel.
        hidden: kinds of Gaussians that are left out.
        box: Gaussians whose centres are outside are left out; None keeps all.
    """

    channel: Channel = "colours"
    hidden: Collection[str] = field(default=())
    box: Box | None = None


def kept(subject: Subject, look: Look) -> Tensor | None:
    """Which Gaussians are drawn, `[N]` bool; None for all."""
    mask = torch.ones(subject.model.count, dtype=torch.bool)
    for kind in look.hidden:
        mask &= ~subject.kinds[kind]
    if look.box is not None:
        means = subject.model.read("means")
        low, high = torch.tensor(look.box.low), torch.tensor(look.box.high)
        mask &= ((means >= low) & (means <= high)).all(dim=1)
    return None if mask.all() else mask


def pictured(
    subject: Subject, camera: Camera, channel: Channel, drawn: Tensor | None = None
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """The picture `[H, W, 3]`, and the z-depth `[H, W]` of what it shows, world units.

    The depth is infinite where the Gaussians stop less than half of the light.

    Args:
        drawn: which Gaussians are, as `kept` says.
    """
    scale = None if drawn is None else drawn.float()
    with torch.no_grad():
        rendering = subject.model.render(camera, background=subject.background, opacity_scale=scale)
    hit = rendering.alpha > 0.5
    depth = torch.where(hit, rendering.depth / rendering.alpha.clamp(min=0.5), math.inf)
    return to_bytes(_channel(rendering, channel)), depth.numpy()


def _channel(rendering: Rendering, channel: Channel) -> Tensor:
    if channel == "depth":
        return depth_picture(rendering)
    if channel == "alpha":
        return rendering.alpha[..., None].expand(-1, -1, 3)
    return rendering.rgb


def camera_of(
    rotation: NDArray[np.float64],
    position: NDArray[np.float64],
    field_of_view: float,
    width: int,
    height: int,
) -> Camera:
    """A camera as viser describes it.

    Args:
        rotation: `[3, 3]`, camera to world; the camera's axes are OpenCV's.
        position: `[3]` world units.
        field_of_view: vertical, radians.
    """
    pose = np.eye(4)
    pose[:3, :3] = rotation.T
    pose[:3, 3] = -rotation.T @ position
    return Camera.centered(pose, 0.5 * height / math.tan(0.5 * field_of_view), width, height)
