"""`feed_forward`: the Gaussians of a feed-forward model, with their shapes, opacities and colours."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from registry import (
    Initializer,
    PointCloud,
    Prior,
    Register,
    SceneError,
    Settings,
    TrainingScene,
    hookimpl,
)
from registry.priors import GaussiansPrior

if TYPE_CHECKING:
    from collections.abc import Mapping

FAINTEST = 1 / 255
"""Opacity below which a Gaussian is never rendered, and so gets no gradient."""


class FeedForwardSettings(Settings):
    prior: str | None = None
    """Name of the prior; null uses the only one that returns Gaussians."""


class FeedForwardInitializer(Initializer[FeedForwardSettings]):
    """The Gaussians that a prior estimates from the training views, without invisible ones."""

    ablation_baseline = "sfm"
    needs_priors = ("gaussians",)

    def initialize(self, scene: TrainingScene, priors: Mapping[str, Prior[Any]]) -> PointCloud:
        """Return at least one Gaussian.

        Raises:
            PluginError: the pipeline has no prior that returns Gaussians, or several and `prior` is null.
            SceneError: the prior returns none that is visible.
        """
        prior = GaussiansPrior.choose(priors, self.settings.prior)
        found = prior.gaussians(scene.train, scene.bounds)
        visible = found if found.opacities is None else found.subset(found.opacities >= FAINTEST)
        if not len(visible):
            raise SceneError(
                f"the prior returned {len(found)} Gaussians, none with an opacity of 1/255 or more",
                where=scene.name,
                fix="use the initializer `sfm`, and check what the prior expects",
            )
        return visible


@hookimpl
def stereogs_register_initializers(register: Register[FeedForwardInitializer]) -> None:
    register("feed_forward", FeedForwardInitializer)
