"""`gradient_aware_decay`: opacities decay, the less the more the loss depends on them (StereoGS).

With g_i = |dL/d alpha_i|, beta_i = g_i / mean(g) and gamma = 1 - (1 - base) exp(-sensitivity beta_i),
each opacity becomes gamma_i alpha_i: after the backward pass, before densification and before Adam.
It takes the place of the periodic reset.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from registry import Context, OpacityPolicy, OpacityUpdate, Register, Settings, Step, hookimpl

if TYPE_CHECKING:
    from collections.abc import Mapping

    from torch import Tensor

QUANTILES_EVERY = 25
"""Iterations between two looks at the quantiles, which need a sort."""

Function = Literal["exp_beta", "exp_g", "step", "linear", "constant"]


class GradientAwareDecaySettings(Settings):
    function: Function = "exp_beta"
    """How the gradient weakens the decay: the paper's exp_beta, or one of those it compares with."""
    base: float = Field(0.99, gt=0, le=1)
    """The factor of a Gaussian without gradient; 1 switches the decay off."""
    sensitivity: float = Field(0.5, ge=0)
    """How fast a gradient weakens the decay."""
    wrt: Literal["activated", "logit"] = "activated"
    """Which gradient: of the opacity itself, or of its logit, which vanishes near 0 and 1."""
    scope: Literal["all", "visible", "contributing"] = "all"
    """Who decays: every Gaussian, as in the paper; those that touched a pixel in this iteration; or those
    whose opacity had a gradient in it. The latter two spare what dropout left out."""


class GradientAwareDecay(OpacityPolicy[GradientAwareDecaySettings]):
    """alpha <- gamma(gradient) * alpha; the optimizer's moments stay as they are."""

    # 3DGS resets every 3,000 of 30,000 iterations, in their first half.
    ablation_baseline = "{use: opacity_reset, every: 10%, stop: 49.9%}"

    def __init__(self, settings: GradientAwareDecaySettings, context: Context) -> None:
        from .decay_statistics import UnseenPruned

        super().__init__(settings, context)
        self._unseen = UnseenPruned()

    def update(self, step: Step) -> OpacityUpdate | None:
        """Return the decayed opacities; None, and no decay, if a gradient is not finite.

        Logs what the paper plots: means, the share of gradients below their mean (beta < 1), every 25
        iterations the 5, 25, 50, 75 and 95 % quantiles of gradient and beta; and how many Gaussians
        have been pruned so far that got no gradient between two edits.
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
        # Without any gradient (nothing was visible) all decay alike.
        relative = gradient / mean if mean > 0 else torch.zeros_like(gradient)
        factor = self.factor(gradient, relative)
        if self.settings.scope != "all":
            decays = gradient > 0 if self.settings.scope == "contributing" else step.model.touched()
            factor = torch.where(decays, factor, 1.0)
        self._unseen.see(gradient > 0)
        self._log(step, gradient, relative, factor)
        return OpacityUpdate(factor * opacities)

    def _log(self, step: Step, gradient: Tensor, relative: Tensor, factor: Tensor) -> None:
        from .decay_statistics import quantiles

        mean = float(gradient.mean())
        step.log("opacity_gradient_mean", mean)
        step.log("opacity_gradient_below_mean", float((relative < 1).float().mean()))
        step.log("opacity_decay_mean", float(factor.mean()))
        step.log("pruned_unseen", self._unseen.pruned)
        if step.iteration % QUANTILES_EVERY == 0:
            for percent, value in quantiles(gradient).items():
                step.log(f"opacity_gradient_q{percent:02d}", value)
                step.log(f"opacity_beta_q{percent:02d}", value / mean if mean > 0 else 0.0)

    def factor(self, gradient: Tensor, relative: Tensor) -> Tensor:
        """Gamma `[N]` in [base, 1] for absolute gradients and for those relative to their mean.

        `step` and `linear` are the paper's; linear is clamped, because beyond relative = 1 /
        sensitivity it would make opacities grow.
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
        return 1 - loss * weakened[self.settings.function]()

    def carry(self, source: Tensor, fresh: Tensor) -> None:
        """Count what was pruned without ever having had a gradient since the edit before."""
        self._unseen.edit(source)

    def state(self) -> dict[str, Tensor]:
        """Who has had a gradient since the last edit, and the count of those pruned without."""
        return self._unseen.state()

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Take back what `state` returned."""
        self._unseen.restore(state)


@hookimpl
def stereogs_register_opacity_policies(register: Register[GradientAwareDecay]) -> None:
    register("gradient_aware_decay", GradientAwareDecay)
