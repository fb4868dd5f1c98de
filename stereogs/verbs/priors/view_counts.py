"""Find multi-view networks that are right for one number of views only.

An exporter that traces a network with two views may keep that number as a constant, although the axis of the
views is open in the file. The graph then runs with more views and is silently wrong.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import torch

from registry.priors import MultiViewDepthPrior

if TYPE_CHECKING:
    from collections.abc import Sequence

    from registry import Prior, TrainingView
    from registry.toolkit.networks import OnnxModel

LARGEST_CHANGE = 0.1
"""Largest median relative change of the depth if a view is given twice."""
REMEDY = (
    "export it with an open number of views; or set `max_sources: 1` if it was "
    "exported with two views, and check again"
)


def fault_of_view_count(
    prior: Prior[Any], model: OnnxModel, views: Sequence[TrainingView], bounds: tuple[float, float]
) -> str:
    """Compare the depth of the first view from two views with that from three.

    A copy of the second view adds nothing, so that it must not change the depth much; the copy with an
    inverted image contradicts it and must change something.

    Returns:
        What is wrong and how to mend it, or an empty text. Nothing is compared for other priors, and for
        graphs with a fixed number of views, which get that number.
    """
    # A set of images is [1, V, 3, H, W].
    sizes = [spec.shape[1] for spec in model.inputs if len(spec.shape) == 5]
    if not isinstance(prior, MultiViewDepthPrior) or not sizes or sizes[0] is not None:
        return ""
    first, second = views[:2]
    copy = replace(second, name=f"{second.name} again")
    inverted = replace(copy, image=1 - copy.image)
    two, three, contradicted = (
        prior.estimate([first, second, *more], bounds)[0] for more in ([], [copy], [inverted])
    )
    known = two.valid & three.valid
    if not known.any():
        return f"no pixel has a depth both from two views and from three. {REMEDY}"
    change = float(((two.depth - three.depth).abs() / two.depth)[known].median())
    if change > LARGEST_CHANGE:
        return (
            f"a copy of the second view as third changes the depth by {change:.0%}: the graph keeps the "
            f"number of views of its export. {REMEDY}"
        )
    several = getattr(prior.settings, "max_sources", 2) > 1
    if several and torch.equal(three.depth, contradicted.depth):
        return f"the depth does not depend on the third view. {REMEDY}"
    return ""
