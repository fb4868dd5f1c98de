"""How far away a prior takes each pixel of a photograph to be."""

from __future__ import annotations

from typing import TYPE_CHECKING

from registry.priors import DepthMap, MonocularDepthPrior, MultiViewDepthPrior
from registry.toolkit.networks.image_fitting import at_size

if TYPE_CHECKING:
    from collections.abc import Mapping
    from typing import Any

    from torch import Tensor

    from registry import Prior, Step, TrainingView


class Farness:
    """Asks a prior once a view and remembers its answers.

    Args:
        prior: name of a monocular or multi-view depth prior; None takes the only monocular one, or
            where there is none the only multi-view one.
    """

    def __init__(self, prior: str | None) -> None:
        self._prior = prior
        self._known: dict[str, tuple[Tensor, Tensor]] = {}

    def of(self, step: Step) -> tuple[Tensor, Tensor]:
        """Of the step's view, at the size of its render.

        Returns:
            `[H, W]` float32 that grows with depth: the depth itself, world units, or minus a monocular
            prior's inverse depth; and `[H, W]` bool, where it is known. What the photograph's alpha leaves
            empty, or partly so, has no depth, whatever the prior takes it for.

        Raises:
            PluginError: no such prior, or several.
        """
        name = step.view.name
        if name not in self._known:
            self._known |= self._asked(step)
        farness, known = self._known[name]
        size = step.rendering.depth.shape
        return at_size(farness, *size), at_size(known, *size)

    def _asked(self, step: Step) -> dict[str, tuple[Tensor, Tensor]]:
        import torch

        view = step.view
        if self._monocular(step.priors):
            prior = MonocularDepthPrior.choose(step.priors, self._prior)
            farness = -prior.inverse_depth_of(view)
            return {view.name: (farness, _shown(view, torch.ones_like(farness, dtype=torch.bool)))}
        several = MultiViewDepthPrior.choose(step.priors, self._prior)
        maps: list[DepthMap] = several.depths(step.scene.train, step.scene.bounds)
        return {
            one.name: (known.depth, _shown(one, known.valid))
            for one, known in zip(step.scene.train, maps, strict=True)
        }

    def _monocular(self, priors: Mapping[str, Prior[Any]]) -> bool:
        able = [name for name, one in priors.items() if isinstance(one, MonocularDepthPrior)]
        return self._prior in able if self._prior is not None else bool(able)


def _shown(view: TrainingView, known: Tensor) -> Tensor:
    """Where something is known of what the photograph shows, `[H, W]` bool."""
    return known if view.solid is None else known & view.solid
