"""`empty_background`: penalize alpha where the photograph shows background.

A Gaussian with the colour of a plain backdrop does not change the photometric loss, but occludes the object
in other views. Binocular3DGS (Han et al. 2024) uses the mean of alpha over all pixels, weighted by 1 - the
photograph's alpha; CoR-GS (Zhang et al. 2024) and DNGaussian (Li et al. 2024) on DTU use the mean of alpha^2
over the background pixels.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from registry import Context, Register, Regularizer, Settings, Step, hookimpl
from registry.toolkit.images import at_size, dark_background

if TYPE_CHECKING:
    from torch import Tensor

    from registry import TrainingView


class EmptyBackgroundSettings(Settings):
    squared: bool = False
    """Use the mean of alpha squared over the background instead of the mean of alpha over all pixels."""
    dark: int | None = Field(None, ge=1, le=255)
    """In photographs without alpha, pixels are background if all channels are below this 8-bit value, there
    and in the 50 pixels to their left; published for DTU: 30, 15 for scan 110. null: no background."""


class EmptyBackground(Regularizer[EmptyBackgroundSettings]):
    """mean alpha (1 - a) over all pixels, with the photograph's alpha a.

    Squared it is mean alpha^2 (1 - a) / mean (1 - a).
    """

    def __init__(self, settings: EmptyBackgroundSettings, context: Context) -> None:
        super().__init__(settings, context)
        self._known: dict[str, Tensor | None] = {}

    def loss(self, step: Step) -> Tensor:
        """Return the loss for this iteration's view; 0 if its photograph has no background."""
        import torch

        view = step.view
        if view.name not in self._known:
            self._known[view.name] = self._background(view)
        background = self._known[view.name]
        if background is None:
            return torch.zeros(())
        alpha = step.rendering.alpha
        share = at_size(background, *alpha.shape)
        if self.settings.squared:
            # A reduced render may contain no background pixel.
            return (alpha.square() * share).sum() / share.sum().clamp(min=1e-6)
        return (alpha * share).mean()

    def _background(self, view: TrainingView) -> Tensor | None:
        """Return each pixel's background share times its weight, `[H, W]`; None without background."""
        if view.alpha is not None:
            share = 1 - view.alpha
        elif self.settings.dark is not None:
            share = dark_background(view.image, self.settings.dark).float()
        else:
            return None
        share = share if view.weights is None else share * view.weights
        return share if share.any() else None


@hookimpl
def stereogs_register_regularizers(register: Register[EmptyBackground]) -> None:
    register("empty_background", EmptyBackground)
