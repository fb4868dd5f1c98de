"""Robust bundle adjustment of a model's points and of further matches."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from . import thresholds
from .colmap import (
    Track,
    assemble,
    bundle_adjust,
    copy_of,
    index_of,
    lens_of,
    set_focal,
    with_id,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from .colmap import Camera, Model


def adjusted(
    model: Model,
    matches: Sequence[Track] = (),
    fixed_focal: bool = False,
    own_lens: Sequence[int] = (),
    centre_of: int | None = None,
) -> Model:
    """Return a copy of a model after bundle adjustment; its points are those of the model that agree.

    Args:
        fixed_focal: keep the focal lengths.
        own_lens: images by id that do not share a lens.
        centre_of: lens by id whose principal point is free too, while the other lenses are fixed.
    """
    points = [point for _, point in sorted(model.points3D.items())]
    tracks = [
        Track(
            point.xyz,
            [
                (seen.image_id, model.image(seen.image_id).points2D[seen.point2D_idx].xy)
                for seen in point.track.elements
            ],
        )
        for point in points
    ]
    changed = assemble(model, _lenses(model, own_lens), [*tracks, *matches])
    bundle_adjust(changed, fixed_focal, centre_of)
    for number, key in enumerate(sorted(changed.point3D_ids())):
        point = changed.point3D(key)
        if number < len(points) and point.error <= thresholds.MAX_ERROR:
            point.color = points[number].color
        else:
            changed.delete_point3D(key)
    return changed


def _lenses(model: Model, own_lens: Sequence[int]) -> dict[int, Camera]:
    """Lens of each image by id; new copies for some."""
    lenses = {k: lens_of(model, k) for k in sorted(model.reg_image_ids())}
    for number, k in enumerate(own_lens, start=max(model.cameras) + 1):
        lenses[k] = with_id(lenses[k], number)
    return lenses


def cost(model: Model, other: Model | None = None) -> float:
    """Sum of the soft L1 loss of the errors of all points.

    Points of another model that were dropped count with an error of `MAX_ERROR` in two photographs.
    """
    errors = [point.error for point in model.points3D.values()]
    lengths = [point.track.length() for point in model.points3D.values()]
    if other is not None:
        errors.append(thresholds.MAX_ERROR)
        lengths.append(2 * (other.num_points3D() - model.num_points3D()))
    return float(np.dot(lengths, np.sqrt(1 + np.square(errors) / thresholds.LOSS_SCALE**2) - 1))


def zoomed(model: Model, factor: float) -> Model:
    """Return a copy of a model with its focal lengths multiplied."""
    changed = copy_of(model)
    for lens in changed.cameras.values():
        set_focal(lens, factor * lens.focal_length)
    return changed


def with_focals(model: Model, focals: Sequence[float | None]) -> Model | None:
    """Return a copy of a model with focal lengths by index, or None if one is unknown."""
    changed = copy_of(model)
    for key in model.reg_image_ids():
        focal, lens = focals[index_of(model, key)], lens_of(changed, key)
        if focal is None:
            return None
        set_focal(lens, focal * max(lens.width, lens.height))
    return changed
