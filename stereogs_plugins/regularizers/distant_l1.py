"""`distant_l1`: additional L1 loss on the farthest pixels (D2GS, Song et al. 2025: distance-aware fidelity).

A monocular depth prior determines the farthest pixels of a photograph. The authors' masks come from an
unpublished program.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from registry import Context, Register, Regularizer, Settings, Step, hookimpl
from registry.priors import MonocularDepthPrior
from registry.toolkit.images import at_size

if TYPE_CHECKING:
    from torch import Tensor


class DistantL1Settings(Settings):
    prior: str | None = None
    """Name of the monocular depth prior; null uses the only one."""
    share: float = Field(0.1, gt=0, le=1)
    """Share of a photograph's pixels that count as far."""


class DistantL1(Regularizer[DistantL1Settings]):
    """mean over all pixels and channels of |render - target| at far pixels that train, 0 elsewhere.

    The rendered colours are clamped to [0, 1], as in the authors' code.
    """

    needs_priors = ("monocular_depth",)

    def __init__(self, settings: DistantL1Settings, context: Context) -> None:
        super().__init__(settings, context)
        self._far: dict[str, Tensor] = {}

    def loss(self, step: Step) -> Tensor:
        """Return the loss for this iteration's view.

        Raises:
            PluginError: the prior is missing.
        """
        view = step.view
        if view.name not in self._far:
            prior = MonocularDepthPrior.choose(step.priors, self.settings.prior)
            found = prior.depth_of(view, step.scene.points)
            self._far[view.name] = farthest(found.farness, found.valid, self.settings.share)
        difference = (step.rendering.rgb.clamp(0, 1) - step.sample.target).abs()
        far = at_size(self._far[view.name], *difference.shape[:2])
        if step.sample.weights is not None:
            far = far * step.sample.weights
        return (difference * far[:, :, None]).mean()


def farthest(farness: Tensor, valid: Tensor | None, share: float) -> Tensor:
    """Return the mask of the farthest valid pixels, `[H, W]` bool, including ties.

    Args:
        farness: `[H, W]`, larger = farther.
        valid: `[H, W]` bool; None where all are.
        share: share of the valid pixels.
    """
    known = farness.flatten() if valid is None else farness[valid]
    if not len(known):
        return farness > farness
    count = max(1, round(share * len(known)))
    far = farness >= -(-known).kthvalue(count).values
    return far if valid is None else far & valid


@hookimpl
def stereogs_register_regularizers(register: Register[DistantL1]) -> None:
    register("distant_l1", DistantL1)
