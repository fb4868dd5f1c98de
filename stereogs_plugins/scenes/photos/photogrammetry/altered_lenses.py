"""Photographs that were zoomed or cropped get a lens of their own."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import numpy as np

from . import thresholds
from .bundle_adjustment import adjusted, cost, zoomed
from .colmap import index_of, lens_of

if TYPE_CHECKING:
    from .colmap import Camera, Model


def with_zoomed_lenses(model: Model) -> Model:
    """Return a model in which zoomed photographs have a lens of their own, or the model if there are none.

    Those that were zoomed, or cropped and enlarged, fit the others' lens less exactly, from a wrong place.
    """
    images = sorted(model.reg_image_ids())
    if len(images) < thresholds.MIN_TO_COMPARE or len(model.cameras) == len(images):
        return model
    alone = adjusted(model, own_lens=images)
    focals = {k: lens_of(alone, k).focal_length for k in images}
    separate = []
    for k in images:
        lens = model.image(k).camera_id
        usual = np.median([focals[i] for i in images if model.image(i).camera_id == lens])
        if _differs(focals[k], usual):
            separate.append(k)
    if not separate:
        return model
    own = adjusted(model, own_lens=separate)
    return own if thresholds.MIN_INCREASE * cost(own) < cost(adjusted(model)) else model


def with_cropped_lenses(model: Model) -> Model:
    """Return a model in which cropped photographs have their own principal point, or the same model.

    Only a photograph that shares its lens with no other is tried: most photographs of one size share one. In
    a crop off centre, the principal point is not the centre of the picture. If it is assumed there, the
    photograph fits only from a wrong place, and with few photographs all focal lengths adapt to it.
    """
    lenses = Counter(model.image(k).camera_id for k in model.reg_image_ids())
    if max(lenses.values()) < thresholds.MIN_TO_COMPARE - 1:
        return model
    for lens in (k for k in sorted(lenses) if lenses[k] == 1):
        costs = {}
        for start in thresholds.FOCAL_STARTS:
            moved = _centred(model, lens, start)
            costs[cost(moved, model)] = moved
        least = min(costs)
        falls = thresholds.MIN_FALL * least < cost(adjusted(model), model)
        if falls and _shift(costs[least].camera(lens)) > thresholds.MIN_SHIFT:
            model = costs[least]
    return model


def _centred(model: Model, lens: int, start: float) -> Model:
    """A model after adjustment of the principal point of a lens, from focal lengths times a factor."""
    moved = adjusted(zoomed(model, start), fixed_focal=True)
    # In turn, because COLMAP frees the principal points of all lenses whose focal length is free.
    for _ in range(thresholds.CENTRE_ROUNDS):
        moved = adjusted(adjusted(moved, centre_of=lens))
    return moved


def altered_photos(given: Model, model: Model) -> tuple[int, ...]:
    """Return the indices of photographs with a lens that `given` lacks, zoomed or off centre."""
    lenses = {index_of(model, k): lens_of(model, k) for k in model.reg_image_ids()}
    usual = np.median([lens.focal_length for lens in lenses.values()])
    return tuple(
        index
        for index, lens in sorted(lenses.items())
        if _shift(lens) > thresholds.MIN_SHIFT
        or (lens.camera_id not in given.cameras and _differs(lens.focal_length, usual))
    )


def _differs(focal: float, usual: np.floating) -> bool:
    return bool(abs(np.log(focal / usual)) > np.log(thresholds.MIN_ZOOM))


def _shift(lens: Camera) -> float:
    """Distance of the principal point from the centre, in units of width or height."""
    return float(max(abs(lens.params[1:3] / [lens.width, lens.height] - 0.5)))
