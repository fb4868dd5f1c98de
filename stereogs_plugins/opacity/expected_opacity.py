"""`expected_opacity`: scale the final opacities to their mean under dropout (Chen et al. 2025).

Dropout without compensation trains renders in which a share p of the Gaussians is missing. A render with
all Gaussians and opacities times 1 - p approximates the mean of many such renders. By default it is called
in the last iteration only: in earlier ones it would act as a decay.
"""

from __future__ import annotations

from pydantic import Field

from registry import (
    HostDefaults,
    OpacityPolicy,
    OpacityUpdate,
    Percent,
    Register,
    Settings,
    Step,
    hookimpl,
)


class ExpectedOpacitySettings(Settings):
    rate: float = Field(ge=0, lt=1)
    """Dropout rate p of the training renders."""


class ExpectedOpacity(OpacityPolicy[ExpectedOpacitySettings]):
    """alpha <- (1 - p) alpha; the optimizer skips opacities in that iteration."""

    host_defaults = HostDefaults(start=Percent(100))

    def update(self, step: Step) -> OpacityUpdate:
        """Return the scaled opacities."""
        opacities = (1 - self.settings.rate) * step.model.opacities()
        return OpacityUpdate(opacities, reset_moments=True)


@hookimpl
def stereogs_register_opacity_policies(register: Register[ExpectedOpacity]) -> None:
    register("expected_opacity", ExpectedOpacity)
