"""Photographs of a model that matches or pictures connect; the others are removed.

A wrong model can be consistent in itself because the mapper drops matches that disagree; nearly all verified
matches agree with a correct one.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from . import thresholds
from .colmap import matched_points, open_database, verified_pairs
from .two_view import sampson_distances, share_in_front, transfer_errors

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from .colmap import Database, Model, VerifiedPair
    from .thresholds import Trust

Confirms = Callable[["Model", int, int], bool]
"""Whether the pictures confirm a model's cameras of two images, by id."""
_AGREES = 2 * thresholds.MAX_ERROR
"""Largest Sampson distance, in pixels, of a match that agrees with the cameras."""


def drop_unsupported(database: Path, model: Model, trust: Trust, confirms: Confirms) -> bool:
    """Remove the photographs that are not connected to the others of a model.

    Two photographs are connected if `MIN_SUPPORT` of their matches agree with the cameras and there are very
    many (`Trust`), or `MIN_CHECKED` and the pictures confirm it. The latter is tested only between groups
    that are not connected otherwise.

    Returns:
        whether a connected pair is left, and not all of them are without depth (two_view.py).
    """
    images = sorted(model.reg_image_ids())
    linked = np.zeros((len(images), len(images)), dtype=int)
    deep = np.zeros_like(linked, dtype=bool)
    for (first, second), support in _supports(database, model).items():
        if support.agreeing >= max(thresholds.MIN_MATCHES, thresholds.MIN_SUPPORT * support.total):
            row, column = images.index(first), images.index(second)
            linked[row, column] = linked[column, row] = support.agreeing
            deep[row, column] = support.deep
    enough = linked >= trust.in_triangle
    sure = (linked >= trust.alone) | (enough & (enough.astype(int) @ enough > 0))
    unsure = linked * (linked >= thresholds.MIN_CHECKED)
    _connect(sure, unsure, lambda row, column: confirms(model, images[row], images[column]))
    group = of_one_scale(model, images, sure)
    for k in {*range(len(images))}.difference(group):
        model.deregister_frame(model.image(images[k]).frame_id)
    return bool(deep[np.ix_(group, group)].any())


def is_contradicted(database: Path, model: Model) -> bool:
    """Whether a pair of `MIN_CHECKED` matches or more supports a model with too few of them.

    A model whose lens was fixed is then wrong.
    """
    return any(
        support.total >= thresholds.MIN_CHECKED
        and support.agreeing < thresholds.MIN_SUPPORT * support.total
        for support in _supports(database, model).values()
    )


def of_one_scale(model: Model, images: list[int], links: NDArray[np.bool_]) -> list[int]:
    """Positions in `images` of the largest group of links `[N, N]`, without parts of unknown size.

    Pairs determine the direction between two cameras, not the distance. A part that only one photograph
    connects to the rest has the right size if that one shares points with both.
    """
    points = list(model.points3D.values())
    seen = np.zeros((len(points), len(images)), dtype=bool)
    for row, point in enumerate(points):
        seen[row, [images.index(element.image_id) for element in point.track.elements]] = True
    group = connected(links)[0]
    for k in tuple(group):
        others = [i for i in group if i != k]
        if k not in group or not others:
            continue
        for part in connected(links[np.ix_(others, others)])[1:]:
            small = [others[i] for i in part]
            rest = [i for i in group if i != k and i not in small]
            shared = seen[:, k] & seen[:, small].any(axis=1) & seen[:, rest].any(axis=1)
            if shared.sum() < thresholds.MIN_SHARED:
                group = [i for i in group if i not in small]
    return group


def _connect(
    sure: NDArray[np.bool_],
    unsure: NDArray[np.integer[Any]],
    confirms: Callable[[int, int], bool],
) -> None:
    """Add confirmed links `[N, N]` to `sure` between groups that are not connected.

    The pair with most matches decides about two groups; if it fails, weaker ones do not help.
    """
    failed: list[tuple[int, int]] = []
    pairs = [(int(a), int(b)) for a, b in zip(*np.nonzero(np.triu(unsure)), strict=True)]
    for pair in sorted(pairs, key=lambda pair: -int(unsure[pair])):
        group_of = {k: number for number, group in enumerate(connected(sure)) for k in group}
        groups = {group_of[k] for k in pair}
        if len(groups) == 1 or any(groups == {group_of[k] for k in other} for other in failed):
            continue
        if confirms(*pair):
            sure[pair] = sure[pair[::-1]] = True
        else:
            failed.append(pair)


def connected(links: NDArray[Any]) -> list[list[int]]:
    """Sorted indices of connected groups, the largest and first one first, of a matrix `[N, N]` of links."""
    from scipy.sparse.csgraph import connected_components

    count, labels = connected_components(links, directed=False)
    groups = [np.flatnonzero(labels == label).tolist() for label in range(count)]
    return sorted(groups, key=lambda group: (-len(group), group))


class _Support(NamedTuple):
    """Number of a pair's matches that agree with a model and of all verified ones; False without depth."""

    agreeing: int
    total: int
    deep: bool


def _supports(database: Path, model: Model) -> dict[tuple[int, int], _Support]:
    """Support of each pair of image ids."""
    registered = set(model.reg_image_ids())
    found = {}
    with open_database(database) as opened:
        for pair in verified_pairs(opened):
            if registered.issuperset(pair.images):
                points = matched_points(opened, pair.images, pair.matches)
                agrees = sampson_distances(model, pair.images, *points) <= _AGREES
                if share_in_front(model, pair.images, *points) < thresholds.MIN_IN_FRONT:
                    agrees[:] = False
                deep = pair.has_depth or _shows_depth(opened, model, pair)
                found[pair.images] = _Support(int(agrees.sum()), len(agrees), deep)
    return found


def _shows_depth(database: Database, model: Model, pair: VerifiedPair) -> bool:
    """Whether enough matches of a pair agree with the cameras but not with its homography."""
    homography = pair.homography
    if homography is None:
        return False
    first, second = matched_points(database, pair.images, database.read_matches(*pair.images))
    agreeing = sampson_distances(model, pair.images, first, second) <= _AGREES
    errors = transfer_errors(homography, first[agreeing], second[agreeing])
    return bool((errors > _AGREES).sum() >= thresholds.MIN_OFF_SURFACE * len(errors) > 0)
