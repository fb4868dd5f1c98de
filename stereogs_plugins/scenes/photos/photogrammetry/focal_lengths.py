"""Focal lengths: which are plausible, do points determine them, and do they contradict those in EXIF?"""

from __future__ import annotations

from typing import TYPE_CHECKING

from . import thresholds
from .bundle_adjustment import adjusted, cost, with_focals, zoomed
from .colmap import index_of, lens_of, relative_focal

if TYPE_CHECKING:
    from collections.abc import Sequence

    from .colmap import Camera, Model


def is_plausible(
    model: Model, focals: Sequence[float | None], factor: float = thresholds.FOCAL_FACTOR
) -> bool:
    """Whether focal lengths and distortions of a model are possible.

    Args:
        focals: focal lengths by EXIF in units of the longer side, by index.
        factor: largest ratio to these.
    """
    return all(
        _is_possible(lens_of(model, k), focals[index_of(model, k)], factor)
        for k in model.reg_image_ids()
    )


def _is_possible(lens: Camera, by_exif: float | None, factor: float) -> bool:
    distortion = float(lens.params[lens.extra_params_idxs()[0]])
    shortest, longest = thresholds.FOCAL_RANGE
    if by_exif is not None:
        shortest, longest = by_exif / factor, by_exif * factor
    return shortest < relative_focal(lens) < longest and abs(distortion) < thresholds.MAX_DISTORTION


def are_unusual(focals: Sequence[float | None]) -> bool:
    """Whether a focal length by EXIF would not be plausible without it."""
    shortest, longest = thresholds.FOCAL_RANGE
    return any(focal is not None and not shortest < focal < longest for focal in focals)


def are_determined(model: Model) -> bool:
    """Whether focal lengths longer or shorter by one factor increase the cost clearly."""
    costs = [
        cost(adjusted(zoomed(model, factor), fixed_focal=True))
        for factor in (1.0, thresholds.OTHER_FOCAL, 1 / thresholds.OTHER_FOCAL)
    ]
    return min(costs[1:]) > thresholds.MIN_INCREASE * costs[0]


def contradict_exif(model: Model, focals: Sequence[float | None]) -> bool:
    """Whether the points fit clearly worse with focal lengths by EXIF, where known, than with free ones."""
    images = sorted(model.reg_image_ids())
    free = adjusted(model, own_lens=images)
    by_exif = list(focals)
    for k in images:
        if by_exif[index_of(free, k)] is None:
            by_exif[index_of(free, k)] = relative_focal(lens_of(free, k))
    known = with_focals(free, by_exif)
    assert known is not None
    return cost(adjusted(known, fixed_focal=True), free) > thresholds.MIN_CONTRADICTION * cost(free)
