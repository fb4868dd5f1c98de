"""Render an image for the viewer: colors, depth or alpha of the visible Gaussians, in limited time."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from core_rasterizer import Camera, Rendering
from registry.toolkit.drawing import to_bytes
from registry.toolkit.drawing.pictures import depth_picture

from ...confidence_picture import hatched
from .subject import Subject

Channel = Literal["colours", "depth", "alpha", "guesses hatched"]
CHANNELS: tuple[Channel, ...] = get_args(Channel)
"""The last one needs `Subject.confidence`."""

QUICK_SECONDS = 0.08
"""Time for an image while the camera moves."""
SHARP_SECONDS = 0.8
"""Time for an image once the camera stands still."""
_SELECTED_COLOR, _SELECTED_SHARE = (1.0, 0.9, 0.1), 0.7
_MIN_PIXELS = 120 * 160
_FIRST_GUESS = 2e6
"""Pixels per second before an image has been timed."""
_MEMORY = 0.5
"""Weight of earlier measurements."""


@dataclass(frozen=True)
class Box:
    """An axis-aligned box: lowest and highest corner, world units."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]


@dataclass(frozen=True)
class Look:
    """The user's choices.

    Args:
        channel: content of the image.
        hidden: kinds of Gaussians to leave out.
        box: Gaussians with centers outside are left out; None for no box.
    """

    channel: Channel = "colours"
    hidden: Collection[str] = ()
    box: Box | None = None


def visible(subject: Subject, look: Look, deleted: Tensor) -> Tensor | None:
    """Return a mask `[N]` bool of the Gaussians to render; None for all.

    Args:
        deleted: mask `[N]` bool of Gaussians to leave out.
    """
    mask = ~deleted
    for kind in look.hidden:
        mask &= ~subject.kinds[kind]
    if look.box is not None:
        means = subject.model.read("means")
        low, high = torch.tensor(look.box.low), torch.tensor(look.box.high)
        mask &= ((means >= low) & (means <= high)).all(dim=1)
    return None if mask.all() else mask


def render(
    subject: Subject,
    camera: Camera,
    channel: Channel,
    mask: Tensor | None = None,
    selected: Tensor | None = None,
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Return an image `[H, W, 3]` and its z-depth `[H, W]`, world units.

    The depth is infinite where alpha is at most 0.5.

    Args:
        mask: from `visible`.
        selected: mask `[N]` bool of Gaussians that shine through others; None for none.
    """
    scale = None if mask is None else mask.float()
    with torch.no_grad():
        rendering = subject.model.render(camera, background=subject.background, opacity_scale=scale)
    hit = rendering.alpha > 0.5
    depth = torch.where(hit, rendering.depth / rendering.alpha.clamp(min=0.5), math.inf)
    if channel == "guesses hatched" and subject.confidence is not None:
        image = hatched(rendering.rgb.clamp(0, 1), subject.confidence().of(camera))
    else:
        image = _channel(rendering, channel)
    if selected is not None:
        with torch.no_grad():
            marked = subject.model.render(camera, opacity_scale=selected.float()).alpha[..., None]
        image = image + _SELECTED_SHARE * marked * (torch.tensor(_SELECTED_COLOR) - image)
    return to_bytes(image), depth.numpy()


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
    """Return the camera for viser's description of one.

    Args:
        rotation: `[3, 3]`, camera to world, OpenCV axes.
        position: `[3]`, world units.
        field_of_view: vertical, radians.
    """
    pose = np.eye(4)
    pose[:3, :3] = rotation.T
    pose[:3, 3] = -rotation.T @ position
    return Camera.centered(pose, 0.5 * height / math.tan(0.5 * field_of_view), width, height)


class Pace:
    """Chooses image sizes by the measured rendering speed."""

    def __init__(self) -> None:
        self._pixels_per_second = _FIRST_GUESS

    def size(self, width: int, height: int, seconds: float) -> tuple[int, int]:
        """Return the largest size with the window's aspect ratio that probably renders in `seconds`."""
        pixels = max(_MIN_PIXELS, self._pixels_per_second * seconds)
        factor = min(1.0, math.sqrt(pixels / (width * height)))
        return max(1, round(width * factor)), max(1, round(height * factor))

    def add(self, pixels: int, seconds: float) -> None:
        """Update the speed with the time of an image."""
        speed = pixels / max(seconds, 1e-6)
        self._pixels_per_second = _MEMORY * self._pixels_per_second + (1 - _MEMORY) * speed
