"""`position_noise`: add noise to the positions of faint Gaussians (3DGS-MCMC).

Kheradmand et al. 2024: with noise, training samples from a distribution (Langevin dynamics) instead of
descending to the nearest minimum. Nearly opaque Gaussians do not move. The factor 5e5 of the authors' code
assumes learning rates of the positions relative to the scene's extent.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from pydantic import Field

from registry import Perturbation, Register, Settings, Step, hookimpl

if TYPE_CHECKING:
    from collections.abc import Mapping

    from torch import Tensor


STEEPNESS = 100.0
"""How fast the noise decreases as the opacity rises above `opacity` (the authors' code)."""


class PositionNoiseSettings(Settings):
    removed: ClassVar = {"steepness": STEEPNESS}
    factor: float = Field(5e5, ge=0, allow_inf_nan=False)
    """Noise per learning rate of the means."""
    opacity: float = Field(0.005, ge=0, le=1)
    """Opacity at which the noise has half its strength."""


class PositionNoise(Perturbation[PositionNoiseSettings]):
    """mean <- mean + rate * factor * sigmoid(-100 (alpha - opacity)) * Sigma * normal noise."""

    def offsets(self, step: Step) -> Mapping[str, Tensor]:
        """Return the offsets of the means, `[N, 3]` world units."""
        import torch

        settings, model = self.settings, step.model
        noise = torch.randn(model.count, 3, generator=self.generator)
        faintness = torch.sigmoid(-STEEPNESS * (model.opacities() - settings.opacity))
        strength = step.learning_rates["means"] * settings.factor * faintness
        axes = rotations(model.read("quaternions"))
        along = torch.einsum("nji,nj->ni", axes, strength[:, None] * noise)
        return {"means": torch.einsum("nij,nj->ni", axes, model.scales().square() * along)}


def rotations(quaternions: Tensor) -> Tensor:
    """Convert quaternions (w, x, y, z) `[N, 4]` of any length to rotation matrices `[N, 3, 3]`."""
    import torch

    w, x, y, z = torch.nn.functional.normalize(quaternions, dim=1).unbind(1)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return torch.stack([torch.stack(row, dim=1) for row in rows], dim=1)


@hookimpl
def stereogs_register_perturbations(register: Register[PositionNoise]) -> None:
    register("position_noise", PositionNoise)
