"""`normal_consistency` and `prior_normals`: surfaces whose normals agree with Gaussians or with a prior.

2DGS (Huang et al. 2024) aligns flat Gaussians with the surface of the rendered depth; here the normal of a
Gaussian is its smallest axis. A network's normals bend the rendered depth (MonoSDF, Yu et al. 2022).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from registry import (
    Context,
    HostDefaults,
    Percent,
    PluginError,
    Register,
    Regularizer,
    Settings,
    Step,
    hookimpl,
)
from registry.priors import MonocularDepthPrior, NormalPrior
from registry.toolkit.images import at_size
from registry.toolkit.views import depth_normals

if TYPE_CHECKING:
    from torch import Tensor

    from registry import Rendered


class NormalConsistency(Regularizer[Settings]):
    """Mean of alpha - N_axes . N_depth over the solid pixels whose depth has a normal.

    N_axes is the sum of the Gaussians' normals times their shares of the pixel, N_depth the unit normal of
    rendered depth; alpha has no gradient.
    """

    host_defaults = HostDefaults(weight=0.02, start=Percent(20))

    @classmethod
    def needs_rendered(cls, settings: Settings) -> tuple[Rendered, ...]:
        """Return that it reads the normals of the Gaussians."""
        return ("normals",)

    def loss(self, step: Step) -> Tensor:
        """Return the loss, in [0, 2]; 0 if no depth is known."""
        rendering = step.rendering
        surface = depth_normals(rendering, step.sample.camera)
        agreement = (step.normals * surface).sum(dim=2)
        return _mean(rendering.alpha.detach() - agreement, _known(surface, step))


class PriorNormalsSettings(Settings):
    prior: str | None = None
    """Name of a prior that returns normals; null uses the only one."""


class PriorNormals(Regularizer[PriorNormalsSettings]):
    """Mean of 1 - N_prior . N_depth over the solid pixels where both are known.

    The prior returns normals, or monocular depth with normals.
    """

    needs_priors = (("normals", "monocular_depth"),)
    host_defaults = HostDefaults(weight=0.05, start=Percent(20))

    def __init__(self, settings: PriorNormalsSettings, context: Context) -> None:
        super().__init__(settings, context)
        self._normals: dict[str, Tensor] = {}

    def loss(self, step: Step) -> Tensor:
        """Return the loss, in [0, 2]; 0 if no normal is known.

        Raises:
            PluginError: the prior is missing, or returns depth without normals.
        """
        name = step.view.name
        if name not in self._normals:
            self._normals[name] = self._estimated(step)
        surface = depth_normals(step.rendering, step.sample.camera)
        wanted = at_size(self._normals[name], *surface.shape[:2])
        known = _known(surface, step) & wanted.any(dim=2)
        return _mean(1 - (wanted * surface).sum(dim=2), known)

    def _estimated(self, step: Step) -> Tensor:
        priors, name = step.priors, self.settings.prior
        able = [key for key, prior in priors.items() if isinstance(prior, NormalPrior)]
        if name in able or (able and name is None):
            return NormalPrior.choose(priors, name).normals_of(step.view)
        prior = MonocularDepthPrior.choose(priors, name)
        normals = prior.depth_of(step.view, step.scene.points).normals
        if normals is None:
            raise PluginError(
                f"the prior {prior.context.name!r} estimates depth without normals",
                fix="add a prior with normals, or use `normal_consistency`, which needs none",
            )
        return normals


def _known(surface: Tensor, step: Step) -> Tensor:
    """`[H, W]` bool, where depth has a normal and the photograph is solid."""
    known, solid = surface.detach().any(dim=2), step.view.solid
    return known if solid is None else known & at_size(solid, *known.shape)


def _mean(values: Tensor, known: Tensor) -> Tensor:
    return values[known].mean() if known.any() else values.new_zeros(())


@hookimpl
def stereogs_register_regularizers(
    register: Register[NormalConsistency | PriorNormals],
) -> None:
    register("normal_consistency", NormalConsistency)
    register("prior_normals", PriorNormals)
