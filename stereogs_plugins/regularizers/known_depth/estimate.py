"""Depth of photographs from a monocular or multi-view prior, cached per view."""

from __future__ import annotations

from typing import TYPE_CHECKING

from registry.priors import DepthMap, MonocularDepthPrior, MultiViewDepthPrior
from registry.toolkit.images import at_size

if TYPE_CHECKING:
    from collections.abc import Mapping
    from typing import Any

    from torch import Tensor

    from registry import Prior, Step, TrainingView


class Farness:
    """Runs a prior once per view and caches its results.

    Args:
        prior: name of a monocular or multi-view depth prior; None uses the only monocular one, or
            without a monocular prior the only multi-view one.
    """

    def __init__(self, prior: str | None) -> None:
        self._prior = prior
        self._known: dict[str, tuple[Tensor, Tensor]] = {}

    def of(self, step: Step) -> tuple[Tensor, Tensor]:
        """Return the farness of the step's view, at the size of its render.

        Returns:
            `[H, W]` float32 that grows with depth: the depth itself, world units, or a monocular prior's
            `farness`; and `[H, W]` bool, where it is known. Pixels that are transparent or
            semi-transparent in the photograph are unknown.

        Raises:
            PluginError: the prior is missing, or ambiguous.
        """
        name = step.view.name
        if name not in self._known:
            self._known |= self._estimated(step)
        farness, known = self._known[name]
        size = step.rendering.depth.shape
        return at_size(farness, *size), at_size(known, *size)

    def _estimated(self, step: Step) -> dict[str, tuple[Tensor, Tensor]]:
        import torch

        view = step.view
        if self._monocular(step.priors):
            prior = MonocularDepthPrior.choose(step.priors, self._prior)
            found = prior.depth_of(view, step.scene.points)
            valid = found.valid
            if valid is None:
                valid = torch.ones_like(found.values, dtype=torch.bool)
            return {view.name: (found.farness, _shown(view, valid))}
        multi_view = MultiViewDepthPrior.choose(step.priors, self._prior)
        maps: list[DepthMap] = multi_view.depths(step.scene.train, step.scene.bounds)
        return {
            other.name: (known.depth, _shown(other, known.valid))
            for other, known in zip(step.scene.train, maps, strict=True)
        }

    def _monocular(self, priors: Mapping[str, Prior[Any]]) -> bool:
        names = [name for name, prior in priors.items() if isinstance(prior, MonocularDepthPrior)]
        return self._prior in names if self._prior is not None else bool(names)


def _shown(view: TrainingView, known: Tensor) -> Tensor:
    """Restrict a mask `[H, W]` to the photograph's solid pixels."""
    return known if view.solid is None else known & view.solid
