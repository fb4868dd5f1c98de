"""Refinement of estimated cameras by dense matches (matches.py).

Few photographs share too few keypoints to determine focal length and poses exactly. Robust bundle adjustment
of the model's points, then of dense matches too, determines them better. Every fourth match takes no part in
it: the result is kept only if these agree better with the new cameras, or if EXIF gives a focal length that
the points do not determine.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from registry import SceneError

from .. import thresholds
from ..altered_lenses import altered_photos, with_cropped_lenses, with_zoomed_lenses
from ..bundle_adjustment import adjusted, with_focals
from ..focal_lengths import are_determined, is_plausible
from ..two_view import sampson_distances
from .matches import dense_matches

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from ..colmap import Array, Model, Track


class Refined(NamedTuple):
    """A refined model.

    Args:
        focal_is_known: whether points or EXIF determine its focal length.
        altered: indices of photographs that seem to be zoomed or cropped.
    """

    model: Model
    focal_is_known: bool
    altered: tuple[int, ...] = ()


def refine(model: Model, images: Path, focals: Sequence[float | None]) -> Refined:
    """Refine the cameras and points of a model, which is returned unchanged if that does not help.

    If the points do not determine the focal lengths, those by EXIF are used instead of the estimated ones if
    all are known; otherwise those of the model are kept if free ones become implausible.

    Args:
        images: folder of the photographs, named by index.
        focals: focal lengths by EXIF in units of the longer side, by index.
    """
    from core_rasterizer import CameraError

    if not thresholds.MIN_PHOTOS <= model.num_reg_images() <= thresholds.MAX_REFINED:
        return Refined(model, True)
    given, model = model, with_cropped_lenses(with_zoomed_lenses(model))
    altered = altered_photos(given, model)
    start = adjusted(model)
    determined = are_determined(start)
    by_exif = None if determined else with_focals(start, focals)
    fixed = by_exif is not None or not is_plausible(start, focals)
    if fixed:
        start = adjusted(by_exif or model, fixed_focal=True)
    try:
        matches = dense_matches(start, images)
    except (SceneError, CameraError):  # the lens is not plausible
        return Refined(model, determined, altered)
    left_out = matches[:: thresholds.HELD_OUT_EVERY]
    fitted = [match for k, match in enumerate(matches) if k % thresholds.HELD_OUT_EVERY]
    if not fitted:
        return Refined(model, determined, altered)
    refined = adjusted(start, fitted, fixed)
    helps = is_plausible(refined, focals)
    helps = helps and (by_exif is not None or _error(refined, left_out) < _error(model, left_out))
    known = determined or (by_exif is not None and helps)
    return Refined(refined if helps else model, known, altered)


def _error(model: Model, matches: Sequence[Track]) -> float:
    """Mean distance of matches from their epipolar lines, each at most `MAX_ERROR` pixels."""
    places: dict[tuple[int, int], list[tuple[Array, Array]]] = {}
    for match in matches:
        (here, corner), *others = match.seen
        for there, place in others:
            places.setdefault((here, there), []).append((corner, place))
    distances = [
        sampson_distances(model, pair, *np.array(of_pair).swapaxes(0, 1))
        for pair, of_pair in places.items()
    ]
    return float(np.minimum(np.concatenate(distances), thresholds.MAX_ERROR).mean())
