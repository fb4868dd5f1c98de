"""`co_pruning`: remove Gaussians that another field has nothing near (CoR-GS, Zhang et al. 2024).

Two fields that learn the same few photographs agree where these settle the geometry, and differ where
they do not: a Gaussian without a counterpart is most likely in the wrong place.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from registry import Densification, PluginError, Register, Settings, Step, hookimpl

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Edit, GaussianReader


class CoPruningSettings(Settings):
    distance: float = Field(gt=0)
    """A Gaussian stays if each other field has a centre nearer than this, world units. CoR-GS, in
    COLMAP's units: 5 on LLFF, 10 on DTU, 20 on Mip-NeRF 360."""


class CoPruning(Densification[CoPruningSettings]):
    """Prunes by the distance to the nearest centre in each other field (`training.fields`).

    Two fields that are pruned one after the other lose what they would lose at once: whoever is some
    centre's only counterpart has one itself.
    """

    needs_fields = 2

    def refine(self, step: Step) -> Edit:
        """Return what is to be pruned.

        Raises:
            PluginError: there is a single field, or no Gaussian has a counterpart.
        """
        import torch

        from core_rasterizer import Edit

        if not step.others:
            raise PluginError(
                "there is no other field to compare with", fix="set `training.fields` to 2"
            )
        lonely = torch.zeros(step.model.count, dtype=torch.bool)
        for other in step.others:
            lonely |= self._without_counterpart(step.model, other.model)
        if lonely.all():
            raise PluginError(
                f"no Gaussian has a counterpart within {self.settings.distance:g} in every other field",
                fix="raise `distance`; it is in world units, and scenes differ in theirs",
            )
        step.log(f"{self.context.name}_pruned", int(lonely.sum()))
        return Edit(prune=lonely)

    def _without_counterpart(self, model: GaussianReader, other: GaussianReader) -> Tensor:
        import torch
        from scipy.spatial import KDTree

        distances, _ = KDTree(other.read("means").numpy()).query(
            model.read("means").numpy(), distance_upper_bound=self.settings.distance
        )
        return torch.from_numpy(distances).isinf()


@hookimpl
def stereogs_register_densifications(register: Register[CoPruning]) -> None:
    register("co_pruning", CoPruning)
