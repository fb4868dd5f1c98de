"""Masks of single photographs, for example of the sky or of people."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, ClassVar

from ..contract.component import SettingsType
from ..contract.prior import Prior
from ..contract.scene import TrainingView
from ..errors import PluginError
from .capabilities import at_work, check_finite, check_shape
from .prior_cache import cached

if TYPE_CHECKING:
    from torch import Tensor


class MaskPrior(Prior[SettingsType]):
    """A prior that says how much each pixel of a photograph counts in training.

    The host asks every such prior of a pipeline before the initializer, and multiplies the answers with the
    weights of the training views (`TrainingView.weights`). Scores do not change.
    """

    capability: ClassVar[str] = "masks"

    @abstractmethod
    def estimate(self, image: Tensor) -> Tensor:
        """Return `[H, W]`, bool or floating point in [0, 1]: 1 where a pixel trains, 0 where it is left out.

        Args:
            image: `[H, W, 3]` float32 in [0, 1].
        """

    def mask(self, image: Tensor) -> Tensor:
        """Return the mask `[H, W]` float32 in [0, 1] of any image; not cached.

        Raises:
            PluginError: The estimate has a wrong shape, or values that are not in [0, 1].
        """
        with at_work(self):
            answer = self.estimate(image)
            check_shape("mask", answer, tuple(image.shape[:2]))
            check_finite("mask", answer)
            mask = answer.detach().float().contiguous()
            low, high = map(float, mask.aminmax())
            if not 0 <= low <= high <= 1:
                raise PluginError(
                    f"the mask is {low:g} to {high:g}, not 0 to 1",
                    fix="return probabilities, for example the sigmoid of logits",
                )
            return mask

    def mask_of(self, view: TrainingView) -> Tensor:
        """`mask` of a photograph; cached on disk."""
        name = "mask"
        return cached(
            self,
            [view],
            [],
            lambda: {name: self.mask(view.image)},
            lambda found: {name: found[name][..., None].expand(-1, -1, 3)},
        )[name]
