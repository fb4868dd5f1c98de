"""`depth_density_dropout`: drop near and dense Gaussians more often (D2GS, Song et al. 2025).

With few views, Gaussians accumulate close to the cameras while distant regions stay coarse. So the drop
probability grows with nearness to the training camera, with density, and with the iteration:

    p = (depth_weight * nearness + density_weight * density) * rate * share of the third

Nearness is 1 - (z - min) / (max - min) of the z-depth; density is minus the mean distance to six
neighbours, scaled to [0, 1]; the rate grows from `first_rate` to `last_rate` over the run. Unlike plain
dropout, the opacities of the kept Gaussians are not increased.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from registry import Context, Modifier, Register, Settings, Step, hookimpl

if TYPE_CHECKING:
    from collections.abc import Mapping

    from torch import Tensor

NEIGHBOURS = 6
THIRDS = ((0.33, 1.0), (0.67, 0.7), (1.0, 0.3))
"""End of each third of the Gaussians sorted by depth, as a share of all, and the third's factor of p."""


class DepthDensityDropoutSettings(Settings):
    depth_weight: float = Field(0.3, ge=0, le=1)
    """Weight of nearness."""
    density_weight: float = Field(0.7, ge=0, le=1)
    """Weight of density."""
    first_rate: float = Field(0.05, ge=0, le=1)
    """Factor of the probability before the first iteration."""
    last_rate: float = Field(0.3, ge=0, le=1)
    """Factor of the probability in the last iteration."""
    density_every: int = Field(500, ge=1)
    """Iterations between updates of the densities; new Gaussians inherit their parent's density."""


class DepthDensityDropout(Modifier[DepthDensityDropoutSettings]):
    """Opacity factors of 0 or 1."""

    def __init__(self, settings: DepthDensityDropoutSettings, context: Context) -> None:
        super().__init__(settings, context)
        self._density: Tensor | None = None

    def opacity_scale(self, step: Step) -> Tensor:
        """Return `[N]` factors."""
        import torch

        means = step.model.read("means")
        if self._density is None or step.iteration % self.settings.density_every == 0:
            self._density = density(means)
        depth = step.sample.camera.project(means)[2].float()
        chance = self.chance(depth, self._density, step.iteration / step.iterations)
        return (torch.rand(len(means), generator=self.generator) >= chance).float()

    def chance(self, depth: Tensor, density: Tensor, done: float) -> Tensor:
        """Return the drop probability of each Gaussian, `[N]`.

        Args:
            depth: `[N]` z-depths, world units.
            density: `[N]`, in any unit.
            done: completed share of the run, in [0, 1].
        """
        import torch

        settings = self.settings
        nearness, crowd = 1 - _from_0_to_1(depth), _from_0_to_1(density)
        score = settings.depth_weight * nearness + settings.density_weight * crowd
        rate = settings.first_rate + (settings.last_rate - settings.first_rate) * min(1.0, done)
        order, count = depth.argsort(stable=True), len(depth)
        shares, begin = torch.empty_like(depth), 0
        for part, share in THIRDS:
            end = int(part * count)
            shares[order[begin:end]] = share
            begin = end
        return score * rate * shares

    def carry(self, source: Tensor, fresh: Tensor) -> None:
        """Give new Gaussians the density of their source."""
        if self._density is not None:
            self._density = self._density[source]

    def state(self) -> dict[str, Tensor]:
        """Return the densities measured last."""
        return {} if self._density is None else {"density": self._density}

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Restore what `state` returned."""
        self._density = state.get("density")


def density(means: Tensor) -> Tensor:
    """Return minus the mean distance to the min(6, N - 1) nearest neighbours, `[N]` world units.

    Args:
        means: `[N, 3]`, world units.
    """
    import torch
    from scipy.spatial import KDTree

    count = len(means)
    if count < 2:
        return torch.zeros(count)
    positions = means.double().numpy()
    distances, _ = KDTree(positions).query(positions, k=min(NEIGHBOURS + 1, count))
    return -torch.from_numpy(distances[:, 1:]).mean(1).float()


def _from_0_to_1(values: Tensor) -> Tensor:
    """Normalize to [0, 1]; all 0 if the values are equal."""
    low, high = values.aminmax()
    return (values - low) / (high - low) if high > low else values * 0


@hookimpl
def stereogs_register_modifiers(register: Register[DepthDensityDropout]) -> None:
    register("depth_density_dropout", DepthDensityDropout)
