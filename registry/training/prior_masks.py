"""Masks from priors, which lower the weights of pixels of training views."""

from __future__ import annotations

from dataclasses import replace

from ..contract.scene import Scene, View
from ..errors import PluginError
from ..pipeline.parts import Part, Parts
from ..priors import MaskPrior
from ..toolkit.progress.stages import tracked


def with_prior_masks(scene: Scene, parts: Parts) -> Scene:
    """Return the scene with the weights of its training views times the masks of the pipeline's priors.

    Raises:
        PluginError: a prior failed, or no pixel of a photograph is left.
    """
    for part in parts.priors_of(MaskPrior):
        views = tracked(list(scene.train), "masks")
        scene = replace(scene, train=tuple(_masked(view, part) for view in views))
    return scene


def _masked(view: View, part: Part) -> View:
    mask = part.component.mask_of(view)
    weights = mask if view.weights is None else view.weights * mask
    if not weights.any():
        raise PluginError(
            f"the mask leaves no pixel of {view.name!r} to train on",
            where=str(part.item),
            fix="leave the photograph out, or change the prior's settings",
        )
    return view if (mask == 1).all() else replace(view, weights=weights)
