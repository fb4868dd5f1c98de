"""Scores of rendered views against their photographs, and pictures of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch

from core_rasterizer import GaussianModel, Rendering

from .blame import blame
from .parts import Part
from .pictures import save_view_pictures
from .scene import Scene, View


@dataclass(frozen=True)
class Scores:
    """Metrics of some views.

    Args:
        views: each view's scores by metric.
    """

    views: dict[str, dict[str, float]]

    @property
    def mean(self) -> dict[str, float]:
        """Each metric's mean over the views; empty if there is no view."""
        rows = list(self.views.values())
        names = rows[0] if rows else {}
        return {name: sum(row[name] for row in rows) / len(rows) for name in names}


def evaluate(
    model: GaussianModel,
    scene: Scene,
    views: Sequence[View],
    metrics: Sequence[Part],
    pictures: Path | None = None,
) -> Scores:
    """Render views and score them, colours clamped to [0, 1].

    Args:
        metrics: the pipeline's metric components.
        pictures: a folder for `save_view_pictures`; None writes none.

    Raises:
        PluginError: a metric failed.
    """
    scores: dict[str, dict[str, float]] = {}
    for view in views:
        rendering = render_view(model, scene, view)
        scores[view.name] = {}
        for part in metrics:
            with blame(part.item):
                value = part.component.measure(rendering.rgb, view.image, view.mask)
                scores[view.name][part.item.name] = float(value)
        if pictures is not None:
            save_view_pictures(rendering, view, pictures)
    return Scores(scores)


def render_view(model: GaussianModel, scene: Scene, view: View) -> Rendering:
    """One view without gradients, colours clamped to [0, 1]."""
    with torch.no_grad():
        rendering = model.render(view.camera, background=scene.background)
    return Rendering(rendering.rgb.clamp(0, 1), rendering.depth, rendering.alpha)
