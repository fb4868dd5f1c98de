"""`distant_l1`: the farthest pixels count more (D2GS, Song et al. 2025: distance-aware fidelity).

A monocular depth prior says which pixels of a photograph are farthest; there, the difference of colours
enters the loss once more. Their own masks come from a program that is not public.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from registry import Context, Register, Regularizer, Settings, Step, hookimpl
from registry.priors import MonocularDepthPrior
from registry.toolkit.networks.image_fitting import at_size

if TYPE_CHECKING:
    from torch import Tensor


class DistantL1Settings(Settings):
    prior: str | None = None
    """Which monocular depth prior to ask; null takes the pipeline's only one."""
    share: float = Field(0.1, gt=0, le=1)
    """How many of a photograph's pixels are far, as a part of all."""


class DistantL1(Regularizer[DistantL1Settings]):
    """mean over all pixels and channels of |render - target| where a pixel is far, 0 elsewhere.

    The render's colours are clamped to [0, 1], as in the authors' code.
    """

    needs_priors = ("monocular_depth",)

    def __init__(self, settings: DistantL1Settings, context: Context) -> None:
        super().__init__(settings, context)
        self._far: dict[str, Tensor] = {}

    def loss(self, step: Step) -> Tensor:
        """The term for this iteration's view.

        Raises:
            PluginError: no such prior.
        """
        view = step.view
        if view.name not in self._far:
            prior = MonocularDepthPrior.choose(step.priors, self.settings.prior)
            self._far[view.name] = farthest(prior.inverse_depth_of(view), self.settings.share)
        difference = (step.rendering.rgb.clamp(0, 1) - step.sample.target).abs()
        far = at_size(self._far[view.name], *difference.shape[:2])
        return (difference * far[:, :, None]).mean()


def farthest(inverse: Tensor, share: float) -> Tensor:
    """Which pixels are among the farthest, `[H, W]` bool; those as far as the last of them are too.

    Args:
        inverse: `[H, W]` inverse depth.
        share: how many of the pixels.
    """
    count = max(1, round(share * inverse.numel()))
    return inverse <= inverse.flatten().kthvalue(count).values


@hookimpl
def stereogs_register_regularizers(register: Register[DistantL1]) -> None:
    register("distant_l1", DistantL1)
