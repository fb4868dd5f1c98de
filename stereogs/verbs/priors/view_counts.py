"""Find multi-view networks that are right for one number of views only.

An exporter that traces a network with two views may keep that number as a constant, although the axis of the
views is open in the file. The graph then runs with more views and is silently wrong.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch

from registry.priors import MultiViewDepthPrior, PosedDepthPrior

if TYPE_CHECKING:
    from collections.abc import Sequence

    from torch import Tensor

    from registry import Prior, TrainingView
    from registry.toolkit.networks import OnnxModel

LARGEST_CHANGE = 0.1
"""Largest median relative change of the depth if a view is given twice."""
REMEDY = (
    "export it with an open number of views; or set `max_sources: 1` if it was "
    "exported with two views, and check again"
)


def fault_of_view_count(
    prior: Prior[Any],
    model: OnnxModel | Path,
    views: Sequence[TrainingView],
    bounds: tuple[float, float],
) -> str:
    """Compare the depth of the first view from two views with that from three.

    A copy of the second view adds nothing, so that it must not change the depth much; the copy with an
    inverted image contradicts it and must change something.

    Returns:
        What is wrong and how to mend it, or an empty text. Nothing is compared for other priors, and for
        graphs with a fixed number of views, which get that number.
    """
    if not _takes_any_number(prior, model):
        return ""
    first, second = views[:2]
    copy = replace(second, name=f"{second.name} again")
    inverted = replace(copy, image=1 - copy.image)
    two, three, contradicted = (
        _first_depth(prior, [first, second, *more], bounds) for more in ([], [copy], [inverted])
    )
    known = (two > 0) & (three > 0)
    if not known.any():
        return f"no pixel has a depth both from two views and from three. {REMEDY}"
    scale = _scale(prior, two[known], three[known])
    change = float(((two - scale * three).abs() / two)[known].median())
    if change > LARGEST_CHANGE:
        return (
            f"a copy of the second view as third changes the depth by {change:.0%}: the graph keeps the "
            f"number of views of its export. {REMEDY}"
        )
    several = getattr(prior.settings, "max_sources", 2) > 1
    if several and torch.equal(three, contradicted):
        return f"the depth does not depend on the third view. {REMEDY}"
    return ""


def _takes_any_number(prior: Prior[Any], model: OnnxModel | Path) -> bool:
    if isinstance(prior, PosedDepthPrior):
        least, most = prior.accepted_views
        return least <= 2 and (most is None or most > 2)
    if isinstance(model, Path):
        return isinstance(prior, MultiViewDepthPrior)
    # A set of images is [1, V, 3, H, W].
    sizes = [spec.shape[1] for spec in model.inputs if len(spec.shape) == 5]
    return isinstance(prior, MultiViewDepthPrior) and sizes[:1] == [None]


def _first_depth(
    prior: Prior[Any], views: Sequence[TrainingView], bounds: tuple[float, float]
) -> Tensor:
    """Depth `[H, W]` of the first view, 0 where unknown."""
    if isinstance(prior, PosedDepthPrior):
        depth = prior.estimate([view.image for view in views], [None] * len(views))[0].depth
        return depth.where(depth.isfinite(), 0.0)
    assert isinstance(prior, MultiViewDepthPrior)
    answer = prior.estimate(views, bounds)[0]
    return answer.depth.where(answer.valid, 0.0)


def _scale(prior: Prior[Any], two: Tensor, three: Tensor) -> float:
    """Return the factor from the unit of the second depths to that of the first."""
    return float((two / three).median()) if isinstance(prior, PosedDepthPrior) else 1.0
