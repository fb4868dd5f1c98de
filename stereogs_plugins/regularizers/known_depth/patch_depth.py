"""`patch_depth`: compare rendered and prior depth in normalized patches (DNGaussian, Li et al. 2024).

Monocular depth has no scale, and its error varies slowly across the image; patches normalized by mean and
standard deviation can be compared. The hard form renders opaque Gaussians of fixed shape and moves only
their centres; the soft form changes only opacities. Use both with `step: alone`.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING, ClassVar, Literal

from pydantic import Field

from registry import Context, HostDefaults, PluginError, Regularizer, Settings, Step

from .estimate import Farness

if TYPE_CHECKING:
    from torch import Tensor

HARD_OPACITY = 0.95
"""Opacity of every Gaussian in the hard form."""
SHARE_OF_IMAGE = 0.01
"""Share of the image's standard deviation added to that of a patch, to avoid amplifying flat patches."""
SMALLEST = 1e-8
"""Added to square roots, whose slope at 0 is infinite, and to divisors."""

LOCAL_WEIGHT = 0.1
"""Weight of patches normalized by their own standard deviation; those normalized by the image's have 1."""


class PatchDepthSettings(Settings):
    removed: ClassVar = {"local_weight": LOCAL_WEIGHT, "global_weight": 1.0}
    form: Literal["hard", "soft"]
    """hard: moves centres, with opacities fixed at 0.95; soft: changes opacities."""
    prior: str | None = None
    """Name of a monocular or multi-view depth prior; null uses the only one, monocular first."""
    smallest: int = Field(5, ge=2)
    """Smallest side of the square patches, pixels. DNGaussian: 5 on LLFF and Blender, 17 on DTU."""
    largest: int = Field(17, ge=2)
    """Largest side; each iteration draws one. DNGaussian: 17 on LLFF and Blender, 53 on DTU."""
    tolerance: float = Field(2.5e-4, ge=0, allow_inf_nan=False)
    """Differences of normalized depth up to this are ignored. DNGaussian: 2.5e-4 on LLFF, 0.01 on DTU."""


class PatchDepth(Regularizer[PatchDepthSettings]):
    """Mean squared difference of normalized depths over the pixels that differ by more than a tolerance.

    With the mean m and standard deviation s of a patch and S of the image, local normalization is
    (x - m) / (s + 0.01 S), global (x - m) / S without gradient through S. In photographs with alpha only
    `solid` pixels are used.

    Raises:
        PluginError: the smallest side is larger than the largest.
    """

    needs_priors = (("monocular_depth", "multi_view_depth"),)
    host_defaults = HostDefaults(step="alone")

    def __init__(self, settings: PatchDepthSettings, context: Context) -> None:
        super().__init__(settings, context)
        if settings.smallest > settings.largest:
            raise PluginError(
                f"the smallest patch, {settings.smallest}, is larger than the largest, {settings.largest}",
                fix="swap `smallest` and `largest`",
            )
        self._farness = Farness(settings.prior)

    @property
    def moves(self) -> Collection[str]:
        """The parameters with a gradient: the centres, or the opacities."""
        return ("means",) if self.settings.form == "hard" else ("opacity_logits",)

    def loss(self, step: Step) -> Tensor:
        """Return the loss for the iteration's view; 0 if no patch is known."""
        import torch

        settings = self.settings
        target, known = self._farness.of(step)
        drawn = torch.randint(settings.smallest, settings.largest + 1, (), generator=self.generator)
        side = min(int(drawn), *known.shape)
        rendered = Patches(self._depth(step), known, side)
        wanted = Patches(target, known, side)
        local = self._difference(rendered, wanted, "local")
        return LOCAL_WEIGHT * local + self._difference(rendered, wanted, "global")

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


class Patches:
    """Square, non-overlapping patches of a map, starting at its first row and column.

    Args:
        image: `[H, W]`.
        known: `[H, W]` bool; other pixels are excluded from means and standard deviations.
        side: pixels, at most H and W.

    Attributes:
        values, known: `[P, side * side]`; a patch with fewer than two known pixels is unknown.
    """

    def __init__(self, image: Tensor, known: Tensor, side: int) -> None:
        self.values = _cut(image, side)
        self.known = _cut(known, side)
        self.known = self.known & (self.known.sum(dim=1, keepdim=True) >= 2)
        self._spread = _spread(image[known][None], known[known][None])[0]

    def normalized(self, form: Literal["local", "global"]) -> Tensor:
        """Subtract each patch's mean; divide by its own or the image's deviation; 0 where unknown."""
        count = self.known.sum(dim=1, keepdim=True).clamp(min=1)
        mean = (self.values * self.known).sum(dim=1, keepdim=True) / count
        centred = (self.values - mean) * self.known
        if form == "global":
            return centred / (self._spread.detach() + SMALLEST)
        own = _spread(self.values, self.known)
        return centred / (own + SHARE_OF_IMAGE * self._spread + SMALLEST)


def _cut(image: Tensor, side: int) -> Tensor:
    return image.unfold(0, side, side).unfold(1, side, side).reshape(-1, side * side)


def _spread(values: Tensor, known: Tensor) -> Tensor:
    """Return the standard deviation `[P, 1]` of the known values, with Bessel's correction."""
    count = known.sum(dim=1, keepdim=True)
    mean = (values * known).sum(dim=1, keepdim=True) / count.clamp(min=1)
    squares = ((values - mean) * known).square().sum(dim=1, keepdim=True)
    return (squares / (count - 1).clamp(min=1) + SMALLEST**2).sqrt()
