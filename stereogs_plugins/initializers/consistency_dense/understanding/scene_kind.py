"""What kind of scene the photographs show."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from core_rasterizer import Camera

    from ..projection import Mask
    from .kinds import SceneKind

WIDEST_FORWARD = 35.0
"""Degrees between the axes of two cameras; forward-facing captures stay below."""
LEAST_BACKGROUND = 0.1
"""Part of the median view's pixels that plain background takes around an object."""


def scene_kind(cameras: Sequence[Camera], backgrounds: Sequence[Mask]) -> SceneKind:
    """The kind of scene.

    Args:
        cameras: of the training views.
        backgrounds: `[H, W]` the plain background of each view.

    Returns:
        "object" where plain background surrounds it; "forward-facing" where all cameras look the same
        way; otherwise "surrounding": a room, a place, or an object in one.
    """
    if np.median([mask.mean() for mask in backgrounds]) >= LEAST_BACKGROUND:
        return "object"
    axes = np.stack([camera.world_to_camera[2, :3].numpy() for camera in cameras])
    widest = np.degrees(np.arccos((axes @ axes.T).clip(-1, 1).min()))
    return "forward-facing" if widest < WIDEST_FORWARD else "surrounding"
