"""From matches to cameras: several mapping methods, until one places every photograph.

Incremental mapping (Schoenberger and Frahm 2016) starts from a pair with a wide triangulation angle. COLMAP
requires 16 degrees, which gives an exact start but excludes forward-facing captures; 2 degrees suffice for
those. Global mapping (Pan et al. 2024) needs no initial pair. The last attempt keeps the initial lens: with
little perspective, matches fit any focal length. Wrong models are contradicted by matches or by the pictures
(`drop_unsupported`), or have implausible lenses.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from itertools import count as numbers_from
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from registry.toolkit.progress import progress

from .no_depth import MIN_OFF_SURFACE, has_depth, transfer_errors
from .unposed_photos import MIN_PHOTOS, image_index

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    _Array = NDArray[np.float64]

MAX_ERROR = 2.0
"""Largest error of matches and points, pixels; COLMAP's 4 is meant for much larger photographs."""
SEED = 0
FOCAL_RANGE = (0.5, 4.0)
"""Plausible focal lengths without EXIF, in units of the longer side."""
FOCAL_FACTOR = 3.0
"""Plausible ratio to the focal length by EXIF and its inverse. Cropping does not change EXIF."""
MAX_DISTORTION = 1.0
"""Largest radial term k1; beyond it the picture would fold before its corners."""
MIN_SUPPORT = 0.9
"""Least share of the matches of a pair that agree with a model; correct ones have 0.95 or more in general."""
_FIRST_PAIR_DEGREES = (16.0, 2.0)
_log = logging.getLogger("stereogs.photos")


class Trust(NamedTuple):
    """Matches that connect two photographs without a look at the pictures.

    Args:
        in_triangle: least number, if a third photograph has as many with both.
        alone: least number without a third photograph.
    """

    in_triangle: int
    alone: int


MIN_MATCHES = 15
"""Least number of matches that support a pair."""
MIN_CHECKED = 30
"""Matches that connect two photographs if the pictures confirm it (dense/check.py). Fewer are inexact: once,
cameras were off by ten degrees along the epipolar lines, which pictures do not show."""
SIFT_TRUST = Trust(MIN_MATCHES, 60)
LEARNED_TRUST = Trust(150, 200)
"""Networks also match unrelated pictures (20 to 60 matches, of which a part fits any geometry) and opposite
sides of symmetric objects (up to 180, in triangles too, but there one of the pairs had fewer than 140)."""
MIN_SHARED = 3
"""Points that give two parts of a model the same scale. Three correct models had 6 or more; one had none, and
positions wrong by 44 % of their spread."""
_ALWAYS_CHECKED = Trust(2**31, 2**31)
Confirms = Callable[[Any, int, int], bool]
"""Whether the pictures confirm a model's cameras of two images, by id."""


class Piece(NamedTuple):
    """A connected group of photographs.

    Args:
        folder: COLMAP model with photographs named by index.
        members: sorted indices of its photographs.
        focal_is_known: False if neither matches nor EXIF determine the focal length.
        fixed_lens: True if the initial lens was kept.
        altered: indices of photographs that seem to be zoomed or cropped.
    """

    folder: Path
    members: list[int]
    focal_is_known: bool = True
    fixed_lens: bool = False
    altered: Sequence[int] = ()


def place_cameras(
    colmap: Any,
    database: Path,
    images: Path,
    folder: Path,
    focals: Sequence[float | None],
    trust: Trust,
    confirms: Confirms,
) -> list[Piece]:
    """Return the pieces of the best attempt, best first; empty if no two photographs connect.

    Photographs and models that the matches or the pictures contradict are discarded, as are models with an
    implausible lens. Attempts run in order of cost; the one that places most photographs is returned.

    Args:
        database: keypoints, matches and two-view geometries.
        images: folder of the photographs, for the colours of points.
        folder: folder for the models.
        focals: focal length by EXIF of each photograph, in units of the longer side.
        trust: matches that suffice to connect photographs.
        confirms: decides about pairs with fewer.
    """
    best: list[Piece] = []
    count = len(focals)
    if count == 2:
        trust = _ALWAYS_CHECKED
    for attempt in _attempts(colmap, count):
        if placed(best) >= attempt.enough:
            break
        target = folder / attempt.name
        target.mkdir()
        found = [
            model
            for model in attempt.run(database, images, target).values()
            if is_plausible(model, focals)
            and drop_unsupported(colmap, database, model, trust, confirms)
            and not (attempt.fixed_lens and is_contradicted(colmap, database, model))
        ]
        best = max(best, _pieces(found, target, attempt.fixed_lens), key=placed)
    return best


def placed(pieces: list[Piece]) -> int:
    """Number of photographs in the best piece."""
    return len(pieces[0].members) if pieces else 0


class _Attempt(NamedTuple):
    """A mapping function.

    Args:
        enough: number of photographs placed before that makes the attempt unnecessary.
        fixed_lens: True if the initial lens is kept.
    """

    name: str
    run: Callable[[Path, Path, Path], dict[int, Any]]
    enough: int
    fixed_lens: bool = False


def _attempts(colmap: Any, total: int) -> list[_Attempt]:
    """Attempts for a number of photographs, cheapest first.

    Two photographs do not determine the focal length: the initial one is kept. With more, a fixed lens could
    place photographs that do not belong to it, so it is only for those that no free lens connects.
    """

    def incremental(
        degrees: float, fixed_lens: bool
    ) -> Callable[[Path, Path, Path], dict[int, Any]]:
        options = _incremental_options(colmap, degrees)
        options.ba_refine_focal_length = options.ba_refine_extra_params = not fixed_lens

        def attempt(*paths: Path) -> dict[int, Any]:
            number = numbers_from(2)  # after the first pair
            progress("cameras", 0, total)
            found: dict[int, Any] = colmap.incremental_mapping(
                *(*paths, options),
                next_image_callback=lambda: progress("cameras", next(number), total),
            )
            return found

        return attempt

    fixed = [
        _Attempt(f"fixed_lens_{d:g}", incremental(d, True), min(MIN_PHOTOS, total), True)
        for d in _FIRST_PAIR_DEGREES
    ]
    if total == 2:
        return fixed
    options = _global_options(colmap)
    return [
        *(
            _Attempt(f"incremental_{d:g}", incremental(d, False), total)
            for d in _FIRST_PAIR_DEGREES
        ),
        _Attempt("global", lambda *paths: colmap.global_mapping(*paths, options), total),
        fixed[-1],
    ]


def _incremental_options(colmap: Any, degrees: float) -> Any:
    options = colmap.IncrementalPipelineOptions(num_threads=1, random_seed=SEED, min_model_size=2)
    options.mapper.init_min_tri_angle = degrees
    # With few photographs most points are seen by only two.
    options.triangulation.ignore_two_view_tracks = False
    options.mapper.filter_max_reproj_error = MAX_ERROR
    options.triangulation.merge_max_reproj_error = MAX_ERROR
    options.triangulation.complete_max_reproj_error = MAX_ERROR
    return options


def _global_options(colmap: Any) -> Any:
    options = colmap.GlobalPipelineOptions(num_threads=1, random_seed=SEED)
    options.mapper.num_threads = 1
    options.mapper.retriangulation.ignore_two_view_tracks = False
    return options


def _pieces(found: list[Any], folder: Path, fixed_lens: bool) -> list[Piece]:
    pieces = []
    for number, model in enumerate(found):
        path = folder / f"model_{number}"
        path.mkdir()
        model.write(path)
        members = sorted(image_index(model.image(k).name) for k in model.reg_image_ids())
        pieces.append(Piece(path, members, fixed_lens=fixed_lens))
    return sorted(pieces, key=lambda piece: -len(piece.members))


def is_plausible(model: Any, focals: Sequence[float | None], factor: float = FOCAL_FACTOR) -> bool:
    """Whether focal lengths and distortions of a model are possible.

    Args:
        focals: focal lengths by EXIF in units of the longer side, by index.
        factor: largest ratio to these.
    """
    images = map(model.image, model.reg_image_ids())
    return all(
        _is_possible(model.camera(image.camera_id), focals[image_index(image.name)], factor)
        for image in images
    )


def _is_possible(camera: Any, by_exif: float | None, factor: float) -> bool:
    focal = camera.focal_length / max(camera.width, camera.height)
    bend = float(camera.params[camera.extra_params_idxs()[0]])
    shortest, longest = FOCAL_RANGE
    if by_exif is not None:
        shortest, longest = by_exif / factor, by_exif * factor
    return shortest < focal < longest and abs(bend) < MAX_DISTORTION


def drop_unsupported(
    colmap: Any, database: Path, model: Any, trust: Trust, confirms: Confirms
) -> bool:
    """Remove the photographs that are not connected to the others of a model.

    A wrong model can be consistent in itself because the mapper drops matches that disagree; nearly all
    verified matches agree with a correct one. Two photographs are connected if `MIN_SUPPORT` of their
    matches agree with the cameras and there are very many (`Trust`), or `MIN_CHECKED` and the pictures
    confirm it. The latter is tested only between groups that are not connected otherwise.

    Returns:
        whether a connected pair is left, and not all of them are without depth (no_depth.py).
    """
    images = sorted(model.reg_image_ids())
    linked = np.zeros((len(images), len(images)), dtype=int)
    deep = np.zeros_like(linked, dtype=bool)
    found = _supports(colmap, database, model, 2 * MAX_ERROR)
    for (first, second), support in found.items():
        if support.agreeing >= max(MIN_MATCHES, MIN_SUPPORT * support.total):
            row, column = images.index(first), images.index(second)
            linked[row, column] = linked[column, row] = support.agreeing
            deep[row, column] = support.deep
    enough = linked >= trust.in_triangle
    sure = (linked >= trust.alone) | (enough & (enough.astype(int) @ enough > 0))
    unsure = linked * (linked >= MIN_CHECKED)
    _connect(sure, unsure, lambda row, column: confirms(model, images[row], images[column]))
    group = of_one_scale(model, images, sure)
    for k in {*range(len(images))}.difference(group):
        model.deregister_frame(model.image(images[k]).frame_id)
    return bool(deep[np.ix_(group, group)].any())


def of_one_scale(model: Any, images: list[int], links: NDArray[np.bool_]) -> list[int]:
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
            if shared.sum() < MIN_SHARED:
                group = [i for i in group if i not in small]
    return group


def is_contradicted(colmap: Any, database: Path, model: Any) -> bool:
    """Whether a pair of `MIN_CHECKED` matches or more supports a model with too few of them.

    A model whose lens was fixed is then wrong.
    """
    found = _supports(colmap, database, model, 2 * MAX_ERROR).values()
    return any(
        support.total >= MIN_CHECKED and support.agreeing < MIN_SUPPORT * support.total
        for support in found
    )


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


def _supports(
    colmap: Any, database: Path, model: Any, max_error: float
) -> dict[tuple[int, int], _Support]:
    """Support of each pair of image ids.

    A match agrees if its Sampson distance (Hartley and Zisserman 2004, 11.4.3) is at most `max_error` pixels.
    """
    registered = set(model.reg_image_ids())
    found = {}
    with colmap.Database.open(database) as opened:
        pairs, geometries = opened.read_two_view_geometries()
        for pair, geometry in zip(pairs, geometries, strict=True):
            first, second = colmap.pair_id_to_image_pair(pair)
            matches = geometry.inlier_matches
            if not len(matches) or not registered.issuperset((first, second)):
                continue
            points = (
                opened.read_keypoints(image)[:, :2][matches[:, side]]
                for side, image in enumerate((first, second))
            )
            errors = sampson_distances(model, (first, second), *points)
            deep = has_depth(colmap, geometry) or _shows_depth(
                opened, model, geometry, (first, second), max_error
            )
            found[first, second] = _Support(int((errors <= max_error).sum()), len(errors), deep)
    return found


def _shows_depth(
    database: Any, model: Any, geometry: Any, pair: tuple[int, int], max_error: float
) -> bool:
    """Whether enough matches of a pair agree with the cameras but not with its homography."""
    if geometry.H is None:
        return False
    matches = database.read_matches(*pair)
    first, second = (
        database.read_keypoints(image)[:, :2][matches[:, side]].astype(np.float64)
        for side, image in enumerate(pair)
    )
    agreeing = sampson_distances(model, pair, first, second) <= max_error
    errors = transfer_errors(np.asarray(geometry.H), first[agreeing], second[agreeing])
    return bool((errors > max_error).sum() >= MIN_OFF_SURFACE * len(errors) > 0)


def sampson_distances(
    model: Any, pair: tuple[int, int], first_points: _Array, second_points: _Array
) -> _Array:
    """Sampson distances `[M]` of points `[M, 2]`, in pixels of the first camera."""
    images = [model.image(identity) for identity in pair]
    cameras = [model.camera(image.camera_id) for image in images]
    rays = [
        np.column_stack([camera.cam_from_img(points), np.ones(len(points))])
        for camera, points in zip(cameras, (first_points, second_points), strict=True)
    ]
    motion = images[1].cam_from_world() * images[0].cam_from_world().inverse()
    essential = np.cross(motion.translation, motion.rotation.matrix(), axisb=0, axisc=0)
    lines = [rays[1] @ essential, rays[0] @ essential.T]
    across = (rays[1] * lines[1]).sum(axis=1)
    slope = sum((line[:, :2] ** 2).sum(axis=1) for line in lines)
    distances: _Array = cameras[0].focal_length * np.abs(across) / np.sqrt(slope)
    return distances
