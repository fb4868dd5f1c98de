"""`patch_depth`: rendered and estimated depth agree, patch by normalized patch (DNGaussian, Li et al. 2024).

Monocular depth has no scale, and errs slowly across the image; within patches whose mean and spread are
taken out its shape can be compared. The hard form renders with opaque Gaussians of fixed shape and moves
only their centres, the soft form moves only opacities. Both are meant for `step: alone`.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from registry import Context, PluginError, Regularizer, Settings, Step

from .estimate import Farness
from .patches import Patches

if TYPE_CHECKING:
    from torch import Tensor

HARD_OPACITY = 0.95
"""Of every Gaussian in the hard form."""


class PatchDepthSettings(Settings):
    form: Literal["hard", "soft"]
    """Whether centres move, with opacities fixed at 0.95, or opacities."""
    prior: str | None = None
    """Name of a monocular or multi-view depth prior; null takes the only one, monocular ones first."""
    smallest: int = Field(5, ge=2)
    """Smallest side of the square patches, pixels. DNGaussian: 5 on LLFF and Blender, 17 on DTU."""
    largest: int = Field(17, ge=2)
    """Largest; each iteration draws a side. DNGaussian: 17 on LLFF and Blender, 53 on DTU."""
    tolerance: float = Field(2.5e-4, ge=0, allow_inf_nan=False)
    """Normalized depths may differ by so much for nothing. DNGaussian: 2.5e-4 on LLFF, 0.01 on DTU."""
    local_weight: float = Field(0.1, ge=0, allow_inf_nan=False)
    """Of patches in units of their own spread."""
    global_weight: float = Field(1.0, ge=0, allow_inf_nan=False)
    """Of patches in units of the whole image's spread."""


class PatchDepth(Regularizer[PatchDepthSettings]):
    """The mean squared difference of normalized depths over the pixels that differ by more than a tolerance.

    With the mean m and standard deviation s of a patch and S of the image, local normalization is
    (x - m) / (s + 0.01 S), global (x - m) / S with no gradient through S. What is not `solid` in a
    photograph with an alpha is in no patch.

    Raises:
        PluginError: the smallest side is larger than the largest.
    """

    needs_priors = (("monocular_depth", "multi_view_depth"),)

    def __init__(self, settings: PatchDepthSettings, context: Context) -> None:
        super().__init__(settings, context)
        if settings.smallest > settings.largest:
            raise PluginError(
                f"the smallest patch, {settings.smallest}, is larger than the largest, {settings.largest}",
                fix="exchange `smallest` and `largest`",
            )
        self._farness = Farness(settings.prior)

    @property
    def moves(self) -> Collection[str]:
        """The centres, or the opacities."""
        return ("means",) if self.settings.form == "hard" else ("opacity_logits",)

    def loss(self, step: Step) -> Tensor:
        """The term for the view at hand; 0 where no patch is known."""
        import torch

        settings = self.settings
        target, known = self._farness.of(step)
        drawn = torch.randint(settings.smallest, settings.largest + 1, (), generator=self.generator)
        side = min(int(drawn), *known.shape)
        rendered = Patches(self._depth(step), known, side)
        wanted = Patches(target, known, side)
        return settings.local_weight * self._difference(
            rendered, wanted, "local"
        ) + settings.global_weight * self._difference(rendered, wanted, "global")

    def _difference(
        self, rendered: Patches, wanted: Patches, form: Literal["local", "global"]
    ) -> Tensor:
        difference = rendered.normalized(form) - wanted.normalized(form)
        far = rendered.known & (difference.detach().abs() > self.settings.tolerance)
        return difference[far].square().mean() if far.any() else difference.new_zeros(())

    def _depth(self, step: Step) -> Tensor:
        camera = step.sample.camera
        if self.settings.form == "soft":
            return step.render(camera, detach=("means", "log_scales", "quaternions")).depth
        scale = HARD_OPACITY / step.model.opacities()
        detach = ("log_scales", "quaternions", "opacity_logits")
        return step.render(camera, opacity_scale=scale, detach=detach).depth
