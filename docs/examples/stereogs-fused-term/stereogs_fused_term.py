"""`charbonnier`: a robust colour difference, in one OpenCL kernel that computes the gradient as well.

The render stays on the device, and autograd keeps no image.
"""

from pydantic import Field
from torch import Tensor

from stereogs.api import PixelTerm, Register, Regularizer, Settings, Step, hookimpl

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


@hookimpl
def stereogs_register_regularizers(register: Register[Charbonnier]) -> None:
    register("charbonnier", Charbonnier)
