"""`gradient_aware_decay`: decay opacities, less where the loss has a larger gradient (StereoGS).

With g_i = |dL/d alpha_i|, beta_i = g_i / mean(g) and gamma = 1 - (1 - base) exp(-sensitivity beta_i),
each opacity becomes gamma_i alpha_i: after the backward pass, before densification and before Adam.
It replaces the periodic reset.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from registry import (
    Context,
    HostDefaults,
    OpacityPolicy,
    OpacityUpdate,
    Percent,
    Register,
    Settings,
    Step,
    hookimpl,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

    from torch import Tensor

PERCENTS = (5, 25, 50, 75, 95)
QUANTILES_EVERY = 25
"""Iterations between two logs of the quantiles, which require a sort."""

Function = Literal["exp_beta", "exp_g", "step", "linear", "constant"]


class GradientAwareDecaySettings(Settings):
    function: Function = "exp_beta"
    """How the gradient reduces the decay: the paper's exp_beta, or one of its alternatives."""
    base: float = Field(0.99, gt=0, le=1)
    """Decay factor of a Gaussian without gradient; 1 disables the decay."""
    sensitivity: float = Field(0.5, ge=0)
    """How strongly a gradient reduces the decay."""
    full_views: int | None = Field(None, ge=1)
    """With more training views than this, opacities decay less, in inverse proportion to the number of views:
    they constrain the scene better. null: the same decay for any number."""
    wrt: Literal["activated", "logit"] = "activated"
    """Gradient with respect to the opacity, or to its logit, which vanishes near 0 and 1."""
    scope: Literal["all", "visible", "contributing"] = "all"
    """Gaussians that decay: all, as in the paper; those that touch a pixel in this iteration; or those whose
    opacity has a gradient. The latter two exclude Gaussians dropped by dropout."""


class GradientAwareDecay(OpacityPolicy[GradientAwareDecaySettings]):
    """alpha <- gamma(gradient) * alpha; the optimizer's moments are kept."""

    ablation_baseline = "opacity_reset"
    host_defaults = HostDefaults(start=Percent(3.337))

    def __init__(self, settings: GradientAwareDecaySettings, context: Context) -> None:
        super().__init__(settings, context)
        self._seen: Tensor | None = None  # had a gradient since the last edit, `[N]` bool
        self._pruned_unseen = 0

    def update(self, step: Step) -> OpacityUpdate | None:
        """Return the decayed opacities; None if a gradient is not finite.

        Logs the statistics that the paper plots: means, the share of gradients below their mean (beta < 1),
        every 25 iterations the 5, 25, 50, 75 and 95 % quantiles of gradient and beta; and the number of
        Gaussians pruned so far that had no gradient since the previous edit.
        """
        import torch

        opacities = step.model.opacities()
        gradient = step.model.gradient("opacity_logits").abs()
        if self.settings.wrt == "activated":
            gradient = gradient / (opacities * (1 - opacities)).clamp(min=1e-6)
        mean = float(gradient.mean())
        step.log("opacity_gradient_undefined", float(not math.isfinite(mean)))
        if not math.isfinite(mean):
            return None
        # Without any gradient (nothing visible) all decay by `base`.
        relative = gradient / mean if mean > 0 else torch.zeros_like(gradient)
        share, contributing = self.decay(gradient, relative), gradient > 0
        full, views = self.settings.full_views, len(step.scene.train)
        if full is not None and views > full:
            share *= full / views
        if self.settings.scope != "all":
            # A product takes a third of the time of `torch.where` with a random mask.
            share *= contributing if self.settings.scope == "contributing" else step.model.touched()
        factor = 1 - share
        self._seen = contributing if self._seen is None else self._seen | contributing
        self._log(step, gradient, relative, factor)
        return OpacityUpdate(factor * opacities)

    def _log(self, step: Step, gradient: Tensor, relative: Tensor, factor: Tensor) -> None:
        import numpy as np

        mean = float(gradient.mean())
        step.log("opacity_gradient_mean", mean)
        below = np.count_nonzero(relative.numpy() < 1)
        step.log("opacity_gradient_below_mean", below / len(relative))
        step.log("opacity_decay_mean", float(factor.mean()))
        step.log("pruned_unseen", self._pruned_unseen)
        if step.iteration % QUANTILES_EVERY == 0:
            ordered = np.sort(gradient.numpy())  # a tenth of the time of torch's
            for percent in PERCENTS:
                value = float(ordered[round(percent / 100 * (len(ordered) - 1))])
                step.log(f"opacity_gradient_q{percent:02d}", value)
                step.log(f"opacity_beta_q{percent:02d}", value / mean if mean > 0 else 0.0)

    def decay(self, gradient: Tensor, relative: Tensor) -> Tensor:
        """Return 1 - gamma `[N]` in [0, 1 - base] from absolute gradients and from gradients over their mean.

        `step` and `linear` follow the paper; linear is clamped, because for relative > 1 / sensitivity
        opacities would grow.
        """
        import torch

        loss, sensitivity = 1 - self.settings.base, self.settings.sensitivity
        weakened = {
            "exp_beta": lambda: torch.exp(-sensitivity * relative),
            "exp_g": lambda: torch.exp(-sensitivity * gradient),
            "step": lambda: (relative < 2 * sensitivity).to(relative.dtype),
            "linear": lambda: (1 - sensitivity * relative).clamp(min=0),
            "constant": lambda: torch.ones_like(relative),
        }
        return loss * weakened[self.settings.function]()

    def carry(self, source: Tensor, fresh: Tensor) -> None:
        """Count the pruned Gaussians that had no gradient since the previous edit."""
        import torch

        if self._seen is not None:
            pruned = torch.ones_like(self._seen)
            pruned[source] = False
            self._pruned_unseen += int((pruned & ~self._seen).sum())
        self._seen = None

    def state(self) -> dict[str, Tensor]:
        """Return the Gaussians with a gradient since the last edit, and the count of those pruned without."""
        import torch

        state = {"pruned_unseen": torch.tensor(self._pruned_unseen)}
        return state if self._seen is None else {**state, "seen": self._seen}

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Restore what `state` returned."""
        self._pruned_unseen = int(state["pruned_unseen"])
        self._seen = state.get("seen")


@hookimpl
def stereogs_register_opacity_policies(register: Register[GradientAwareDecay]) -> None:
    register("gradient_aware_decay", GradientAwareDecay)
