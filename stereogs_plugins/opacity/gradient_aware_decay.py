"""`gradient_aware_decay`: opacities decay, the less the more the loss depends on them (StereoGS).

With g_i = |dL/d alpha_i|, beta_i = g_i / mean(g) and gamma = 1 - (1 - base) exp(-sensitivity beta_i),
each opacity becomes gamma_i alpha_i: after the backward pass, before densification and before Adam.
It takes the place of the periodic reset.
"""

from __future__ import annotations

from typing import Literal

import torch
from pydantic import Field
from torch import Tensor

from registry import OpacityPolicy, OpacityUpdate, Register, Settings, Step, hookimpl

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
    scope: Literal["all", "contributing"] = "all"
    """Who decays: every Gaussian, as in the paper, or only those with a gradient in this iteration."""


class GradientAwareDecay(OpacityPolicy[GradientAwareDecaySettings]):
    """alpha <- gamma(gradient) * alpha; the optimizer's moments stay as they are."""

    Settings = GradientAwareDecaySettings

    def update(self, step: Step) -> OpacityUpdate:
        """Return the decayed opacities, and log the share of gradients below their mean."""
        opacities = step.model.opacities()
        gradient = step.model.gradient("opacity_logits").abs()
        if self.settings.wrt == "activated":
            gradient = gradient / (opacities * (1 - opacities)).clamp(min=1e-6)
        mean = gradient.mean()
        # Without any gradient (nothing was visible) all decay alike.
        relative = gradient / mean if mean > 0 else torch.zeros_like(gradient)
        factor = self.factor(gradient, relative)
        if self.settings.scope == "contributing":
            factor = torch.where(gradient > 0, factor, 1.0)
        step.log("opacity_gradient_mean", float(mean))
        step.log("opacity_gradient_below_mean", float((relative < 1).float().mean()))
        step.log("opacity_decay_mean", float(factor.mean()))
        return OpacityUpdate(factor * opacities)

    def factor(self, gradient: Tensor, relative: Tensor) -> Tensor:
        """Gamma `[N]` in [base, 1] for absolute gradients and for those relative to their mean.

        `step` and `linear` are the paper's; linear is clamped, because beyond relative = 1 /
        sensitivity it would make opacities grow.
        """
        loss, sensitivity = 1 - self.settings.base, self.settings.sensitivity
        weakened = {
            "exp_beta": lambda: torch.exp(-sensitivity * relative),
            "exp_g": lambda: torch.exp(-sensitivity * gradient),
            "step": lambda: (relative < 2 * sensitivity).to(relative.dtype),
            "linear": lambda: (1 - sensitivity * relative).clamp(min=0),
            "constant": lambda: torch.ones_like(relative),
        }
        return 1 - loss * weakened[self.settings.function]()


@hookimpl
def stereogs_register_opacity_policies(register: Register[GradientAwareDecay]) -> None:
    register("gradient_aware_decay", GradientAwareDecay)
