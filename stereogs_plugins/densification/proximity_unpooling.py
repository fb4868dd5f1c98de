"""`proximity_unpooling`: insert Gaussians between distant neighbours (FSGS, Zhu et al. 2024).

A large Gaussian far from its three nearest neighbours gets a new one halfway to each of them, with that
neighbour's size and opacity, unrotated and grey. At larger distances it is also split. As in the authors'
code, squared distances are compared with the extent; on most captures these rules apply rarely.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from registry import Densification, HostDefaults, Percent, Register, Settings, Step, hookimpl

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Edit, Gaussians

NEIGHBOURS = 3


class ProximityUnpoolingSettings(Settings):
    distance: float = Field(5.0, gt=0)
    """Minimum mean squared distance to three neighbours, relative to the extent, to insert Gaussians."""
    split_distance: float = Field(10.0, gt=0)
    """Minimum mean squared distance to three neighbours, relative to the extent, to split a Gaussian."""
    size: float = Field(1.0, ge=0)
    """Minimum of a Gaussian's largest scale, relative to the extent, for both."""


class ProximityUnpooling(Densification[ProximityUnpoolingSettings]):
    """Inserts Gaussians halfway between large ones and their three nearest neighbours."""

    host_defaults = HostDefaults(start=Percent(6), stop=Percent(19.9), every=Percent(1), phase=0)

    def refine(self, step: Step) -> Edit | None:
        """Return the edit; None if no Gaussian is far and large. Logs the number of insertions."""
        from core_rasterizer import Edit

        settings, known = self.settings, step.model.gaussians()
        squared, neighbours = proximity(known.means)
        large = step.model.scales().amax(1) > settings.size * step.extent
        isolated = large & (squared > settings.distance * step.extent)
        split = large & (squared > settings.split_distance * step.extent)
        step.log(f"{self.context.name}_added", int(isolated.sum()) * neighbours.shape[1])
        if not (isolated | split).any():
            return None
        parents = neighbours[isolated].reshape(-1)
        source = isolated.nonzero().expand(-1, neighbours.shape[1]).reshape(-1)
        return Edit(add=_between(known, source, parents), parents=parents, split=split)


def proximity(means: Tensor) -> tuple[Tensor, Tensor]:
    """Find the K = min(3, N - 1) nearest neighbours of each point.

    Args:
        means: `[N, 3]`, world units.

    Returns:
        Mean squared distances to them `[N]`, 0 if N is 1, and their indices `[N, K]`.
    """
    import torch
    from scipy.spatial import KDTree

    count = len(means)
    if count < 2:
        return torch.zeros(count), torch.zeros(count, 0, dtype=torch.int64)
    positions = means.double().numpy()
    distances, indices = KDTree(positions).query(positions, k=min(NEIGHBOURS + 1, count))
    squared = torch.from_numpy(distances[:, 1:] ** 2).mean(1)
    return squared.float(), torch.from_numpy(indices[:, 1:]).long()


def _between(known: Gaussians, source: Tensor, neighbour: Tensor) -> Gaussians:
    """Return unrotated grey Gaussians halfway from sources to neighbours, `[M]` indices each."""
    import torch

    from core_rasterizer import Gaussians

    unrotated = torch.zeros(len(source), 4)
    unrotated[:, 0] = 1
    return Gaussians(
        means=(known.means[source] + known.means[neighbour]) / 2,
        log_scales=known.log_scales[neighbour],
        quaternions=unrotated,
        opacity_logits=known.opacity_logits[neighbour],
        sh=torch.zeros_like(known.sh[neighbour]),
    )


@hookimpl
def stereogs_register_densifications(register: Register[ProximityUnpooling]) -> None:
    register("proximity_unpooling", ProximityUnpooling)
