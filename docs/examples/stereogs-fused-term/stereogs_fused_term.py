"""Two components that are one OpenCL kernel each: what they read stays on the device.

`charbonnier` is a robust colour difference; autograd keeps no image. `unused_fade` lowers the opacity of
Gaussians that the loss hardly depends on.
"""

from pydantic import Field
from torch import Tensor

from stereogs.api import (
    GaussianKernel,
    OpacityPolicy,
    OpacityUpdate,
    PixelTerm,
    Register,
    Regularizer,
    Settings,
    Step,
    hookimpl,
)

TERM = PixelTerm(
    """
    #if HAS_trained
    if (!trained[p])
        continue;
    #endif
    const real share = 1 / ((real)3 * width * height);
    for (int c = 0; c < 3; c++) {
        const real error = view_rgb[3 * p + c] - target[3 * p + c];
        const real length = sqrt(error * error + softness * softness);
        loss += share * (length - softness);
        d_view_rgb[3 * p + c] = share * error / length;
    }
    """,
    gradients=["view_rgb"],
    name="charbonnier",
)


FADE = GaussianKernel(
    """
    const lane opacity = 1 / (1 + lane_exp(-opacity_logits));
    const lane unused = lane_exp(-lane_abs(d_opacity_logits) / softness);
    faded = opacity * (1 - rate * unused);
    fading = rate * unused;
    """,
    parameters=["opacity_logits"],
    gradients=["opacity_logits"],
    outputs=["faded"],
    sums=["fading"],
    name="unused_fade",
)


class CharbonnierSettings(Settings):
    softness: float = Field(0.01, gt=0)
    """Difference below which the loss is quadratic."""


class Charbonnier(Regularizer[CharbonnierSettings]):
    """Mean of sqrt(difference^2 + softness^2) - softness over pixels and channels."""

    def loss(self, step: Step) -> Tensor:
        return TERM(
            view=step.rendering,
            target=step.sample.target,
            trained=step.sample.trained,
            softness=self.settings.softness,
        )


class UnusedFadeSettings(Settings):
    rate: float = Field(0.02, ge=0, le=1)
    """Share of the opacity that a Gaussian without gradient loses in each update."""
    softness: float = Field(1e-6, gt=0)
    """Gradient of the opacity logit that reduces the loss of opacity by a factor of e."""


class UnusedFade(OpacityPolicy[UnusedFadeSettings]):
    """Multiply each opacity by 1 - rate * exp(-|gradient| / softness)."""

    def update(self, step: Step) -> OpacityUpdate:
        rate, softness = self.settings.rate, self.settings.softness
        outputs, sums = FADE(step.model, rate=rate, softness=softness)
        step.log("fading_mean", sums["fading"] / step.model.count)
        return OpacityUpdate(outputs["faded"])


@hookimpl
def stereogs_register_regularizers(register: Register[Charbonnier]) -> None:
    register("charbonnier", Charbonnier)


@hookimpl
def stereogs_register_opacity_policies(register: Register[UnusedFade]) -> None:
    register("unused_fade", UnusedFade)
