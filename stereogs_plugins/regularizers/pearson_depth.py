"""`pearson_depth`: correlate rendered depth with a monocular depth prior (FSGS, Zhu et al. 2024).

Monocular depth has no scale, shift or unit, and Pearson's correlation requires none. FSGS applies it to
training views and to virtual views, where the prior runs on the render itself; a `differentiable` prior
also passes gradients to the colours.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from pydantic import Field

from registry import (
    Context,
    HostDefaults,
    PluginError,
    Register,
    Regularizer,
    Settings,
    Step,
    hookimpl,
)
from registry.priors import MonocularDepth, MonocularDepthPrior
from registry.toolkit.images import at_size
from registry.toolkit.views import SOLID, virtual_views

if TYPE_CHECKING:
    from torch import Tensor

CONSTANT = 1e-6
"""Maps with a smaller relative deviation from their mean count as constant."""


class PearsonDepthSettings(Settings):
    prior: str | None = None
    """Name of the monocular depth prior; null uses the only one."""
    views: Literal["training", "box", "between", "sphere"] = "training"
    """The iteration's training view, or a random virtual view: in the box around the training cameras
    (FSGS's code on LLFF), between two neighbours (its paper), or on a sphere."""
    offset: float | None = Field(None, gt=0, allow_inf_nan=False)
    """Also correlate with 1 / (inverse depth + offset), and use the better fit; FSGS: 200 for training
    views, in the units of DPT. null only correlates with minus the inverse depth. Priors that estimate depth,
    or inverse depth without offset, do not need it."""
    ramp_start: int = Field(0, ge=0)
    """Iteration after which the loss factor grows from 0 to 1."""
    ramp_length: int = Field(0, ge=0)
    """Iterations until the factor is 1; 0: it is 1 from the start."""


class PearsonDepth(Regularizer[PearsonDepthSettings]):
    """1 - Pearson's correlation of rendered depth z and the prior's depth, over the pixels of a view.

    z is as blended, not divided by alpha. The loss is 0 if either map is constant. The prior's confidence,
    if it has one, is the weight of a pixel. Only pixels that the prior calls valid are used, for
    photographs with alpha only `solid` ones, and in virtual views only opaque pixels of the render: empty
    pixels have depth 0 and semi-transparent rims are too near, and the loss would fill both with fog.
    """

    needs_priors = ("monocular_depth",)
    host_defaults = HostDefaults(weight=0.05)

    def __init__(self, settings: PearsonDepthSettings, context: Context) -> None:
        super().__init__(settings, context)
        self._known: dict[str, MonocularDepth] = {}

    def loss(self, step: Step) -> Tensor:
        """Return the loss, in [0, 2] times the ramp.

        Raises:
            PluginError: the prior is missing; or inverse depth plus `offset` is not positive.
        """
        depth, estimate, shown = self._maps(step)
        size = tuple(depth.shape)
        values, farness = at_size(estimate.values, *size), at_size(estimate.farness, *size)
        if estimate.valid is not None:
            valid = at_size(estimate.valid, *size)
            shown = valid if shown is None else shown & valid
        weights = None if estimate.confidence is None else at_size(estimate.confidence, *size)
        if shown is not None:
            depth, values, farness = depth[shown], values[shown], farness[shown]
            weights = None if weights is None else weights[shown]
        loss = 1 - correlation(farness, depth, weights)
        shifted = estimate.inverse and estimate.ambiguity == "affine"
        if self.settings.offset is not None and shifted and values.numel():
            other = reciprocal(values, self.settings.offset)
            loss = loss.minimum(1 - correlation(other, depth, weights))
        return self._ramp(step.iteration) * loss

    def _maps(self, step: Step) -> tuple[Tensor, MonocularDepth, Tensor | None]:
        """Return rendered depth `[H, W]`, the prior's, and a pixel mask of the former's size or None."""
        prior = MonocularDepthPrior.choose(step.priors, self.settings.prior)
        kind = self.settings.views
        if kind != "training":
            rendering = step.render(virtual_views.draw(kind, step.scene, self.generator))
            estimate = prior.depth(rendering.rgb.clamp(0, 1))
            empty = any(view.alpha is not None for view in step.scene.train)
            return rendering.depth, estimate, rendering.alpha.detach() > SOLID if empty else None
        name = step.view.name
        if name not in self._known:
            self._known[name] = prior.depth_of(step.view, step.scene.points)
        depth, solid = step.rendering.depth, step.view.solid
        shown = None if solid is None else at_size(solid, *depth.shape)
        return depth, self._known[name], shown

    def _ramp(self, iteration: int) -> float:
        done, length = iteration - self.settings.ramp_start, self.settings.ramp_length
        return min(1.0, max(0.0, done / length)) if length else 1.0


def reciprocal(inverse: Tensor, offset: float) -> Tensor:
    """Return 1 / (inverse depth + offset), `[H, W]`.

    Raises:
        PluginError: the sum is not positive everywhere.
    """
    lowest = float(inverse.detach().min())
    if not lowest + offset > 0:
        raise PluginError(
            f"the prior's inverse depth has the minimum {lowest:g}; plus the offset of {offset:g} it must "
            "be positive",
            fix="use a larger offset, or null",
        )
    return 1 / (inverse + offset)


def correlation(first: Tensor, second: Tensor, weights: Tensor | None = None) -> Tensor:
    """Return Pearson's correlation of two maps of the same shape; 1 without gradient if one is constant.

    Args:
        weights: of the pixels, at least 0; None where all count equally.
    """
    parts = [(_deviation(values, weights), values.detach()) for values in (first, second)]
    lengths = [deviation.norm() for deviation, _ in parts]
    for length, (_, values) in zip(lengths, parts, strict=True):
        if not float(length.detach()) > CONSTANT * float(values.norm()):
            return first.new_ones(())
    cosine: Tensor = (parts[0][0] * parts[1][0]).sum() / (lengths[0] * lengths[1])
    return cosine


def _deviation(values: Tensor, weights: Tensor | None) -> Tensor:
    """Differences to the mean, times the roots of the weights, whose mean becomes 1."""
    if weights is None:
        return values - values.mean()
    share = weights / weights.mean()
    return (values - (share * values).mean()) * share.sqrt()


@hookimpl
def stereogs_register_regularizers(register: Register[PearsonDepth]) -> None:
    register("pearson_depth", PearsonDepth)
