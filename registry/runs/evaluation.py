"""Scores of rendered views against their photographs, and pictures of the views."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, get_args

import numpy as np
import torch
from numpy.typing import NDArray

from core_rasterizer import Camera, ExplainedError, GaussianReader, Model, Rendering

from ..calls.copies import copied
from ..calls.policy import scoring
from ..contract.components import AverageErrorRole, Unavailable
from ..contract.scene import Scene, View
from ..pipeline.parts import Part
from ..pipeline.pipeline import Item
from ..toolkit.drawing.pictures import save_view_pictures

Floats = NDArray[np.float32]
AVERAGE_ERROR = "avge"
"""Name of the average error among the scores."""
_ROLES: tuple[AverageErrorRole, ...] = get_args(AverageErrorRole)
"""In the order of the arguments of `average_error`."""


class Picture(NamedTuple):
    """A rendered camera as numpy arrays, float32.

    Args:
        rgb: `[H, W, 3]` in [0, 1].
        depth: `[H, W]` z-depth in world units, blended: divide by `alpha` where that is not 0.
        alpha: `[H, W]` in [0, 1], opacity of the Gaussians along the ray.
    """

    rgb: Floats
    depth: Floats
    alpha: Floats


@dataclass(frozen=True)
class Scores:
    """Metrics of some views.

    Args:
        views: each view's scores by metric; None where a metric is not available.
        unavailable: reason by metric, from the first view.
        failures: error by qualified name of a metric, from the first view.
    """

    views: dict[str, dict[str, float | None]]
    unavailable: dict[str, str] = field(default_factory=dict)
    failures: dict[str, ExplainedError] = field(default_factory=dict)

    @property
    def infinite(self) -> dict[str, list[str]]:
        """The views for which a metric is infinite, by metric: JSON cannot represent infinity."""
        found = defaultdict[str, list[str]](list)
        for view, row in self.views.items():
            for name, score in row.items():
                if score is not None and math.isinf(score):
                    found[name].append(view)
        return dict(found)

    @property
    def mean(self) -> dict[str, float | None]:
        """Mean of each metric over the views that have it, None if none has; empty without views."""
        found = defaultdict[str, list[float]](list)
        for row in self.views.values():
            for name, score in row.items():
                found[name] += [] if score is None else [score]
        return {name: sum(known) / len(known) if known else None for name, known in found.items()}


def evaluate(
    model: Model,
    scene: Scene,
    views: Iterable[View],
    metrics: Sequence[Part],
    pictures: Path | None = None,
    repeat: bool = False,
) -> Scores:
    """Render views and score them, colours clamped to [0, 1].

    A view with a score in each role of the average error also gets `avge` (`average_error`). If a metric
    fails, the others are still measured. Each metric receives copies.

    Args:
        pictures: folder for `save_view_pictures`; None writes none.
        repeat: ask metrics that do not take long twice about the first view, and compare.
    """
    scores = Scores({})
    for view in views:
        rendering = clamped_render(model, view.camera, scene.background)
        row: dict[str, float | None] = {}
        for part in metrics:
            name = part.item.name
            try:
                given, again = (copied((rendering, view, scene)) for _ in range(2))
                first = repeat and not scores.views
                checks = scoring(first=first, takes_long=part.component.takes_long)
                score = part.call(*given, checks=checks, again=again)
            except ExplainedError as error:
                scores.failures.setdefault(part.item.qualified_name, error)
                score = Unavailable(error.what)
            if isinstance(score, Unavailable):
                scores.unavailable.setdefault(name, score.reason)
            row[name] = None if isinstance(score, Unavailable) else score
        scores.views[view.name] = row | _average_error(row, metrics)
        if pictures is not None:
            save_view_pictures(rendering, view, pictures, scene.frame.unit)
    return scores


def quick(metrics: Sequence[Part]) -> list[Part]:
    """Return the metrics that do not take long, for scores during training and of training views."""
    return [part for part in metrics if not part.component.takes_long]


def averaged(metrics: Sequence[Item]) -> tuple[Item, ...]:
    """Return the first metric of each role in `avge`; empty if a role is missing."""
    roles = [getattr(item.offer.component, "average_error_role", None) for item in metrics]
    if not set(_ROLES) <= set(roles):
        return ()
    return tuple(metrics[roles.index(role)] for role in _ROLES)


def _average_error(
    row: Mapping[str, float | None], metrics: Sequence[Part]
) -> dict[str, float | None]:
    """Return AVGE of one view; empty if a score is unavailable, or if a metric has this name."""
    scores = [row[item.name] for item in averaged([part.item for part in metrics])]
    known = [score for score in scores if score is not None]
    if len(known) < len(_ROLES) or AVERAGE_ERROR in row:
        return {}
    return {AVERAGE_ERROR: average_error(*known)}


def average_error(psnr: float, ssim: float, lpips: float) -> float:
    """Return the geometric mean of the mean squared error 10^(-psnr / 10), sqrt(1 - ssim) and LPIPS.

    Niemeyer et al. 2022 (RegNeRF). Lower is better; 0 for equal images.

    Args:
        psnr: decibels.
        ssim: at most 1, by either definition.
        lpips: at least 0.
    """
    # A rounding error above 1 would make the root imaginary.
    dissimilarity = max(1 - ssim, 0.0) ** 0.5
    return float((10 ** (-psnr / 10) * dissimilarity * max(lpips, 0.0)) ** (1 / 3))


def clamped_render(
    model: Model, camera: Camera, background: tuple[float, float, float]
) -> Rendering:
    """Render a camera without gradients, colours clamped to [0, 1]."""
    return GaussianReader(model).render(camera, background=background)


def as_arrays(rendering: Rendering) -> Picture:
    """Return a rendering as numpy arrays."""
    images = (rendering.rgb, rendering.depth, rendering.alpha)
    return Picture(*(image.detach().to("cpu", torch.float32).numpy() for image in images))
