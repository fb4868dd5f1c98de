"""`empty_background`: nothing stands where a photograph shows its background.

Before a plain backdrop a Gaussian of the backdrop's colour costs the photometric loss nothing, and hides the
object from other views. Binocular3DGS (Han et al. 2024) takes the mean of alpha over all pixels, counted by
1 - the photograph's alpha; CoR-GS (Zhang et al. 2024) and DNGaussian (Li et al. 2024) on DTU the mean of
alpha^2 over the pixels of the backdrop alone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from registry import Context, Register, Regularizer, Settings, Step, hookimpl
from registry.toolkit.networks.image_fitting import at_size
from registry.toolkit.photos import dark_background

if TYPE_CHECKING:
    from torch import Tensor

    from registry import TrainingView


class EmptyBackgroundSettings(Settings):
    squared: bool = False
    """The mean of alpha squared over the background instead of that of alpha over all pixels."""
    dark: int | None = Field(None, ge=1, le=255)
    """In photographs without an alpha channel, pixels whose brightest channel is below this (of 255), and
    the 50 pixels to their left too, are background; published for DTU: 30, 15 for scan 110. null: no
    pixels are."""


class EmptyBackground(Regularizer[EmptyBackgroundSettings]):
    """mean alpha (1 - a) over all pixels, with the photograph's alpha a.

    Squared it is mean alpha^2 (1 - a) / mean (1 - a).
    """

    def __init__(self, settings: EmptyBackgroundSettings, context: Context) -> None:
        super().__init__(settings, context)
        self._known: dict[str, Tensor | None] = {}

    def loss(self, step: Step) -> Tensor:
        """The term for this iteration's view; 0 where its photograph shows no background."""
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
            # In a smaller render none of the background's few pixels may be left.
            return (alpha.square() * share).sum() / share.sum().clamp(min=1e-6)
        return (alpha * share).mean()

    def _background(self, view: TrainingView) -> Tensor | None:
        """How much of each pixel is background, `[H, W]`, or None where there is none."""
        if view.alpha is not None:
            share = 1 - view.alpha
        elif self.settings.dark is not None:
            share = dark_background(view.image, self.settings.dark).float()
        else:
            return None
        return share if share.any() else None


@hookimpl
def stereogs_register_regularizers(register: Register[EmptyBackground]) -> None:
    register("empty_background", EmptyBackground)
