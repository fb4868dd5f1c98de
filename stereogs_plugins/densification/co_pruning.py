"""`co_pruning`: prune Gaussians far from all Gaussians of another field (CoR-GS, Zhang et al. 2024).

Two fields trained on the same photographs agree where the photographs determine the geometry: a Gaussian
without a counterpart in the other field is probably misplaced.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from registry import (
    Densification,
    HostDefaults,
    Percent,
    PluginError,
    Register,
    Settings,
    Step,
    hookimpl,
)

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Edit, GaussianReader
    from registry import Rendered


class CoPruningSettings(Settings):
    distance: float = Field(gt=0)
    """In units of the scene's files; a Gaussian is kept if every other field has a centre within this
    distance. CoR-GS, in COLMAP's units: 5 on LLFF, 10 on DTU, 20 on Mip-NeRF 360."""


class CoPruning(Densification[CoPruningSettings]):
    """Prunes by the distance to the nearest centre in each other field (`training.fields`).

    The order in which two fields are pruned does not matter: being a counterpart is symmetric, so no
    field loses a Gaussian that the other one needs.
    """

    host_defaults = HostDefaults(start=Percent(10), every=Percent(5))

    @classmethod
    def needs_rendered(cls, settings: CoPruningSettings) -> tuple[Rendered, ...]:
        """Return that it compares fields."""
        return ("other_fields",)

    def refine(self, step: Step) -> Edit:
        """Return the pruning mask.

        Raises:
            PluginError: no Gaussian has a counterpart.
        """
        import torch

        from core_rasterizer import Edit

        isolated = torch.zeros(step.model.count, dtype=torch.bool)
        for other in step.others:
            isolated |= self._without_counterpart(step, other.model)
        if isolated.all():
            raise PluginError(
                f"no Gaussian has a counterpart within {self.settings.distance:g} in every other field",
                fix="increase `distance`; its unit is that of the scene's files",
            )
        step.log(f"{self.context.name}_pruned", int(isolated.sum()))
        return Edit(prune=isolated)

    def _without_counterpart(self, step: Step, other: GaussianReader) -> Tensor:
        import torch
        from scipy.spatial import KDTree

        distances, _ = KDTree(other.read("means").numpy()).query(
            step.model.read("means").numpy(),
            distance_upper_bound=self.settings.distance / step.scene.frame.unit,
        )
        return torch.from_numpy(distances).isinf()


@hookimpl
def stereogs_register_densifications(register: Register[CoPruning]) -> None:
    register("co_pruning", CoPruning)
