"""Estimators of how likely each pixel of a render is right."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from .contract.component import Component, SettingsType

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Camera, GaussianReader

    from .contract.scene import DepthMap, TrainingScene

__all__ = ["Confidence", "ConfidenceEstimator", "Trained"]


@dataclass(frozen=True, eq=False)
class Trained:
    """What an estimator may use: the result of a training, and what it was trained on.

    Args:
        model: the Gaussians.
        scene: the training views, without test views and true depth.
        maps, kinds: from the initializer, as in `Step`; may be empty.
        confidence: returns the confidence by an installed estimator's name.
    """

    model: GaussianReader
    scene: TrainingScene
    maps: Mapping[str, DepthMap]
    kinds: Mapping[str, Tensor]
    confidence: Callable[[str], Confidence]


class Confidence(ABC):
    """Confidence in the renders of one training."""

    @abstractmethod
    def of(self, camera: Camera) -> Tensor:
        """Return `[H, W]` float32 in [0, 1]: how likely each pixel of a camera's render is right."""

    def gain(self, camera: Camera) -> float:
        """Return how much a photograph from a camera would add, >= 0; by default the mean of 1 - `of`."""
        return float((1 - self.of(camera)).mean())


class ConfidenceEstimator(Component[SettingsType], ABC):
    """Estimates how likely each pixel of a render is right."""

    @abstractmethod
    def estimate(self, trained: Trained) -> Confidence:
        """Return the confidence in renders of a training; the model must not change afterwards."""
