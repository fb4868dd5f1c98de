"""Surface normals of single images."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, ClassVar

from ..contract.component import SettingsType
from ..contract.prior import Prior
from ..contract.scene import TrainingView
from .capabilities import at_work, check_shape
from .monocular_depth import unit_normals
from .prior_cache import cached

if TYPE_CHECKING:
    from torch import Tensor


class NormalPrior(Prior[SettingsType]):
    """A prior that estimates the surface normals of a single image."""

    capability: ClassVar[str] = "normals"

    @abstractmethod
    def estimate(self, image: Tensor) -> Tensor:
        """Return normals `[H, W, 3]` of any length; 0 or not finite where unknown.

        They point towards the camera, in its axes: x right, y down, z forward, so that a wall that faces
        the camera has (0, 0, -1).

        Args:
            image: `[H, W, 3]` float32 in [0, 1].
        """

    def normals(self, image: Tensor) -> Tensor:
        """Return unit normals `[H, W, 3]` float32 of any image, 0 where unknown; not cached.

        Raises:
            PluginError: The estimate has a wrong shape.
        """
        with at_work(self):
            answer = self.estimate(image)
            check_shape("normals", answer, (*image.shape[:2], 3))
            return unit_normals(answer)

    def normals_of(self, view: TrainingView) -> Tensor:
        """`normals` of a photograph; cached on disk."""
        name = "normals"
        return cached(
            self,
            [view],
            [],
            lambda: {name: self.normals(view.image)},
            lambda found: {name: 0.5 + 0.5 * found[name]},
        )[name]
