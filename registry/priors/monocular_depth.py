"""Relative inverse depth of a single image."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, ClassVar

from ..contract.component import SettingsType
from ..contract.prior import Prior
from ..toolkit.drawing.pictures import nearness_picture
from .checking import check_finite, check_map
from .remembering import remembered

if TYPE_CHECKING:
    from torch import Tensor

    from ..contract.scene import TrainingView


class MonocularDepthPrior(Prior[SettingsType]):
    """Relative inverse depth of a single image.

    `differentiable` says that `estimate` is torch in autograd: answers about images then let gradients
    through to the image.
    """

    capability: ClassVar[str] = "monocular_depth"
    differentiable: ClassVar[bool] = False

    @abstractmethod
    def estimate(self, image: Tensor) -> Tensor:
        """Return `[H, W]` relative inverse depth, larger = nearer, of unknown scale and shift.

        Args:
            image: `[H, W, 3]` float32 in [0, 1].
        """

    def inverse_depth(self, image: Tensor) -> Tensor:
        """Relative inverse depth `[H, W]` float32 of any image, a render for example; not kept.

        Raises:
            PluginError: the answer has the wrong shape or values that are not finite.
        """
        import torch

        wanted = self.differentiable and torch.is_grad_enabled()
        with self.context.at_work(), torch.set_grad_enabled(wanted):
            answer = self.estimate(image)
            check_map("inverse depth", answer, image)
            check_finite("inverse depth", answer)
            return answer.float().contiguous()

    def inverse_depth_of(self, view: TrainingView) -> Tensor:
        """Relative inverse depth `[H, W]` float32 of a photograph; what was asked before is remembered.

        Raises:
            PluginError: see `inverse_depth`.
        """
        import torch

        found = remembered(
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
