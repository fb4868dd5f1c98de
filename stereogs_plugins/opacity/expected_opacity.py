"""`expected_opacity`: at the end, opacities become what dropout left of them on average (Chen et al. 2025).

Dropout that does not raise the opacities of those that stay trains pictures in which a share p is
missing. With all Gaussians in place, opacities times 1 - p show nearly the mean of many such pictures,
at the cost of one. Give it `start: 100%`: earlier it would be a decay.
"""

from __future__ import annotations

from pydantic import Field

from registry import OpacityPolicy, OpacityUpdate, Register, Settings, Step, hookimpl


class ExpectedOpacitySettings(Settings):
    rate: float = Field(ge=0, lt=1)
    """The share p that training renders left out."""


class ExpectedOpacity(OpacityPolicy[ExpectedOpacitySettings]):
    """alpha <- (1 - p) alpha; no step of the optimizer moves it in that iteration."""

    def update(self, step: Step) -> OpacityUpdate:
        """Return the opacities that are to be looked at."""
        opacities = (1 - self.settings.rate) * step.model.opacities()
        return OpacityUpdate(opacities, reset_moments=True)


@hookimpl
def stereogs_register_opacity_policies(register: Register[ExpectedOpacity]) -> None:
    register("expected_opacity", ExpectedOpacity)
