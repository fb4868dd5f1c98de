"""`proximity_unpooling`: where points are far apart, new ones are put in between (FSGS, Zhu et al. 2024).

A large Gaussian far from its three nearest neighbours gets a new one halfway to each of them: as large and
opaque as that neighbour, round and grey. Those farther still are split too. The rules are those of the
authors' code, which compares squared distances with the extent; in most captures they fire rarely.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from registry import Densification, Register, Settings, Step, hookimpl

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Edit, Gaussians

NEIGHBOURS = 3


class ProximityUnpoolingSettings(Settings):
    distance: float = Field(5.0, gt=0)
    """Mean squared distance to three neighbours, in units of the extent, from which on points are put
    in between."""
    split_distance: float = Field(10.0, gt=0)
    """The same, from which on a Gaussian is split."""
    size: float = Field(1.0, ge=0)
    """Largest scale, in units of the extent, that a Gaussian must exceed for either."""


class ProximityUnpooling(Densification[ProximityUnpoolingSettings]):
    """New Gaussians halfway between large ones and their three nearest neighbours."""

    def refine(self, step: Step) -> Edit | None:
        """Return the edit; None where no Gaussian is far and large. Logs how many were added."""
        from core_rasterizer import Edit

        settings, known = self.settings, step.model.gaussians()
        squared, neighbours = proximity(known.means)
        large = step.model.scales().amax(1) > settings.size * step.extent
        lonely = large & (squared > settings.distance * step.extent)
        split = large & (squared > settings.split_distance * step.extent)
        step.log(f"{self.context.name}_added", int(lonely.sum()) * neighbours.shape[1])
        if not (lonely | split).any():
            return None
        parents = neighbours[lonely].reshape(-1)
        source = lonely.nonzero().expand(-1, neighbours.shape[1]).reshape(-1)
        return Edit(add=_between(known, source, parents), parents=parents, split=split)


def proximity(means: Tensor) -> tuple[Tensor, Tensor]:
    """The nearest others of each point, three or as many as there are.

    Args:
        means: `[N, 3]`, world units.

    Returns:
        Mean squared distances to them `[N]`, 0 for one point alone, and their indices `[N, K]`.
    """
    import torch
    from scipy.spatial import KDTree

    count = len(means)
    if count < 2:
        return torch.zeros(count), torch.zeros(count, 0, dtype=torch.int64)
    places = means.double().numpy()
    distances, indices = KDTree(places).query(places, k=min(NEIGHBOURS + 1, count))
    squared = torch.from_numpy(distances[:, 1:] ** 2).mean(1)
    return squared.float(), torch.from_numpy(indices[:, 1:]).long()


def _between(known: Gaussians, source: Tensor, neighbour: Tensor) -> Gaussians:
    """Round grey Gaussians halfway from sources to neighbours, `[M]` indices each."""
    import torch

    from core_rasterizer import Gaussians

    upright = torch.zeros(len(source), 4)
    upright[:, 0] = 1
    return Gaussians(
        means=(known.means[source] + known.means[neighbour]) / 2,
        log_scales=known.log_scales[neighbour],
        quaternions=upright,
        opacity_logits=known.opacity_logits[neighbour],
        sh=torch.zeros_like(known.sh[neighbour]),
    )


@hookimpl
def stereogs_register_densifications(register: Register[ProximityUnpooling]) -> None:
    register("proximity_unpooling", ProximityUnpooling)
