"""Confidence of the Gaussians, from the confidence of pixels."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..drawing.camera_path import smooth_path
from .painted import gathered

if TYPE_CHECKING:
    from torch import Tensor

    from ...confidence import Confidence, Trained

_CAMERAS_PER_VIEW = 2
_MIN_LIGHT = 0.5
"""Light, in pixels of all cameras together, at which the confidence is halved."""


def confidence_of_gaussians(trained: Trained, confidence: Confidence) -> Tensor:
    """Return `[N]` float32 in [0, 1]: the mean confidence of the pixels in which a Gaussian is seen.

    The pixels are those of cameras on a smooth path through the training cameras, because at the training
    cameras themselves a guess looks like the photograph. A Gaussian that no camera sees gets 0.
    """
    cameras = [view.camera for view in trained.scene.train]
    path = smooth_path(cameras, _CAMERAS_PER_VIEW * len(cameras)) if len(cameras) > 1 else cameras
    sums, light = gathered(trained.model, ((one, confidence.of(one)) for one in path))
    return (sums / (light + _MIN_LIGHT)).clamp(0, 1)
