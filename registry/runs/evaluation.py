"""Scores of rendered views against their photographs, and pictures of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import get_args

from core_rasterizer import Camera, ExplainedError, GaussianModel, Rendering

from ..calls.read_only_guard import Overwritten, ReadOnlyGuard, of_rendering, of_view
from ..contract.checks.answers import check_score
from ..contract.components import AverageErrorRole, Unavailable
from ..contract.scene import Scene, View
from ..pipeline.parts import Part
from ..pipeline.pipeline import Item
from ..toolkit.drawing.pictures import save_view_pictures
from .average_error import AVERAGE_ERROR, average_error

_ROLES: tuple[AverageErrorRole, ...] = get_args(AverageErrorRole)
"""In the order in which `average_error` takes them."""


@dataclass(frozen=True)
class Scores:
    """Metrics of some views.

    Args:
        views: each view's scores by metric; None where a metric is not available.
        unavailable: why, by metric; the first view's reason stands for all.
        failures: what went wrong, by the qualified name of each metric that failed or answered no
            number; the first view's error stands for all.
    """

    views: dict[str, dict[str, float | None]]
    unavailable: dict[str, str] = field(default_factory=dict)
    failures: dict[str, ExplainedError] = field(default_factory=dict)

    @property
    def infinite(self) -> dict[str, list[str]]:
        """The views for which a metric is infinite, by metric: JSON has no number for that."""
        found: dict[str, list[str]] = {}
        for view, row in self.views.items():
            for name, score in row.items():
                if score is not None and math.isinf(score):
                    found.setdefault(name, []).append(view)
        return found

    @property
    def mean(self) -> dict[str, float | None]:
        """Each metric's mean over the views that have it, None if none has; empty without views."""
        rows = list(self.views.values())
        names = list(dict.fromkeys(name for row in rows for name in row))
        return {name: _mean([row.get(name) for row in rows]) for name in names}


def evaluate(
    model: GaussianModel,
    scene: Scene,
    views: Sequence[View],
    metrics: Sequence[Part],
    pictures: Path | None = None,
) -> Scores:
    """Render views and score them, colours clamped to [0, 1].

    A view that has a score in each role of the average error also gets `avge` (`average_error`). A metric
    that fails keeps no other from being measured; `Scores.failures` holds its error.

    Args:
        metrics: the pipeline's metric components.
        pictures: a folder for `save_view_pictures`; None writes none.

    Raises:
        Overwritten: a metric wrote into the render or the photograph; no other score could be trusted.
    """
    scores: dict[str, dict[str, float | None]] = {}
    unavailable: dict[str, str] = {}
    failures: dict[str, ExplainedError] = {}
    for view in views:
        rendering = render_view(model, scene, view)
        row: dict[str, float | None] = {}
        lent = of_view(view) + of_rendering(rendering)
        for part in metrics:
            score = _measured(part, lent, rendering, view, scene, failures)
            if isinstance(score, Unavailable):
                unavailable.setdefault(part.item.name, score.reason)
                row[part.item.name] = None
            else:
                row[part.item.name] = score
        scores[view.name] = row | _average_error(row, metrics)
        if pictures is not None:
            save_view_pictures(rendering, view, pictures)
    return Scores(scores, unavailable, failures)


def quick(metrics: Sequence[Part]) -> list[Part]:
    """The metrics without those that take long, for all but the last word on test views."""
    return [part for part in metrics if not part.component.takes_long]


def _measured(
    part: Part,
    lent: ReadOnlyGuard,
    rendering: Rendering,
    view: View,
    scene: Scene,
    failures: dict[str, ExplainedError],
) -> float | Unavailable:
    """A metric's score of a view; of one that fails, why there is none."""
    try:
        with part.at_work(lent=lent):
            return check_score(part.component.measure_view(rendering, view, scene))
    except Overwritten:
        raise
    except ExplainedError as error:
        failures.setdefault(part.item.qualified_name, error)
        return Unavailable(error.what)


def averaged(metrics: Sequence[Item]) -> tuple[Item, ...]:
    """The three metrics that `avge` is made of, the pipeline's first of each; empty if one lacks."""
    roles = [getattr(item.offer.component, "average_error_role", None) for item in metrics]
    if not set(_ROLES) <= set(roles):
        return ()
    return tuple(metrics[roles.index(role)] for role in _ROLES)


def _average_error(
    row: Mapping[str, float | None], metrics: Sequence[Part]
) -> dict[str, float | None]:
    """AVGE of one view; empty if a metric for it is missing or not available, or if a metric is called so."""
    scores = [row[item.name] for item in averaged([part.item for part in metrics])]
    known = [score for score in scores if score is not None]
    if len(known) < len(_ROLES) or AVERAGE_ERROR in row:
        return {}
    return {AVERAGE_ERROR: average_error(*known)}


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if known else None


def render_view(model: GaussianModel, scene: Scene, view: View) -> Rendering:
    """One view without gradients, colours clamped to [0, 1]."""
    return clamped_render(model, view.camera, scene.background)


def clamped_render(
    model: GaussianModel, camera: Camera, background: tuple[float, float, float]
) -> Rendering:
    """A camera without gradients, colours clamped to [0, 1]."""
    return model.reader().render(camera, background=background)
