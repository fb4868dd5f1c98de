"""Capability `monocular_depth`: relative inverse depth of a single image."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, ClassVar

from ..contract.component import SettingsType
from ..contract.prior import Prior
from ..toolkit.drawing.pictures import nearness_picture
from .cached_estimates import cached
from .checking import check_finite, check_map

if TYPE_CHECKING:
    from torch import Tensor

    from ..contract.scene import TrainingView


class MonocularDepthPrior(Prior[SettingsType]):
    """A prior that estimates relative inverse depth of a single image.

    Set `differentiable` to True if `estimate` supports autograd; `inverse_depth` then propagates gradients
    to the image.
    """

    capability: ClassVar[str] = "monocular_depth"
    differentiable: ClassVar[bool] = False

    @abstractmethod
    def estimate(self, image: Tensor) -> Tensor:
        """Return `[H, W]` relative inverse depth, larger = nearer, with unknown scale and shift.

        Args:
            image: `[H, W, 3]` float32 in [0, 1].
        """

    def inverse_depth(self, image: Tensor) -> Tensor:
        """Return relative inverse depth `[H, W]` float32 of any image, for example a render; not cached.

        Raises:
            PluginError: The estimate has a wrong shape or non-finite values.
        """
        import torch

        wanted = self.differentiable and torch.is_grad_enabled()
        with self.context.at_work(), torch.set_grad_enabled(wanted):
            answer = self.estimate(image)
            check_map("inverse depth", answer, image)
            check_finite("inverse depth", answer)
            return answer.float().contiguous()

    def inverse_depth_of(self, view: TrainingView) -> Tensor:
        """Return relative inverse depth `[H, W]` float32 of a photograph; cached on disk.

        Raises:
            PluginError: See `inverse_depth`.
        """
        import torch

        found = cached(
            self,
            [view],
            [],
            lambda: {"inverse_depth": self.inverse_depth(view.image)},
            lambda answer: {
                "inverse_depth": nearness_picture(
                    answer["inverse_depth"], torch.isfinite(answer["inverse_depth"])
                )
            },
        )
        return found["inverse_depth"]
