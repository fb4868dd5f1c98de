"""Refinement of estimated cameras by dense matches (matches.py).

Few photographs share too few keypoints to determine focal length and poses exactly. Robust bundle adjustment
of the model's points, then of dense matches too, determines them better. Every fourth match takes no part in
it: the result is kept only if these agree better with the new cameras, or if EXIF gives a focal length that
the points do not determine.
"""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from registry import SceneError

from ..mapping import MAX_ERROR, is_plausible, sampson_distances
from ..unposed_photos import image_index
from .matches import Match, dense_matches

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

MAX_PHOTOS = 24
"""More photographs determine the cameras without dense matches, which would take long."""
HELD_OUT_EVERY = 4
LOSS_SCALE = 0.5
"""Error in pixels from which the soft L1 loss is linear. Half of the matches are exact to 0.15 pixels."""
MIN_TO_COMPARE = 4
"""Photographs that show whether one of them was zoomed."""
MIN_ZOOM = 1.15
"""Least ratio of a zoomed photograph's focal length to the median, or its inverse; others have up to 1.06."""
OTHER_FOCAL, MIN_INCREASE = 1.25, 1.05
"""The points determine the focal length if a change by this factor increases the cost by that factor."""
MIN_CONTRADICTION = 1.2
"""Least increase of the cost by wrong focal lengths in EXIF. In ten sets of three, true ones increased it
by a factor of up to 1.12; in nine of them, those 4 times as long or short by 1.24 at least."""
MIN_SHIFT, MIN_FALL = 0.03, 1.025
"""Least shift of the principal point of a photograph cropped off centre, in units of width or height, and
least factor by which it reduces the cost. Others shifted by 0.01 at most, with factors up to 1.08."""
_ROUNDS = 4
"""Adjustments of a principal point and of the other lenses in turn."""
_STARTS = (1.0, 0.7, 0.5)
"""Factors of initial focal lengths, which are often much too long if a photograph is cropped off centre."""
_MAX_ITERATIONS, _TOLERANCE = 100, 1e-8


class Refined(NamedTuple):
    """A refined pycolmap model.

    Args:
        focal_is_known: whether points or EXIF determine its focal length.
        altered: indices of photographs that seem to be zoomed or cropped.
    """

    model: Any
    focal_is_known: bool
    altered: tuple[int, ...] = ()


def refine(colmap: Any, model: Any, images: Path, focals: Sequence[float | None]) -> Refined:
    """Refine the cameras and points of a pycolmap model, which is returned unchanged if that does not help.

    If the points do not determine the focal lengths, those by EXIF are used instead of the estimated ones if
    all are known; otherwise those of the model are kept if free ones become implausible.

    Args:
        images: folder of the photographs, named by index.
        focals: focal lengths by EXIF in units of the longer side, by index.
    """
    from core_rasterizer import CameraError

    if not 3 <= model.num_reg_images() <= MAX_PHOTOS:
        return Refined(model, True)
    given, model = model, with_cropped_lenses(colmap, with_zoomed_lenses(colmap, model))
    altered = _altered(given, model)
    start = _adjusted(colmap, model, [])
    determined = _determines_focal(colmap, start)
    by_exif = None if determined else _with_focals(colmap, start, focals)
    fixed = by_exif is not None or not is_plausible(start, focals)
    if fixed:
        start = _adjusted(colmap, by_exif or model, [], fixed)
    try:
        matches = dense_matches(start, images)
    except (SceneError, CameraError):  # the lens is not plausible
        return Refined(model, determined, altered)
    left_out = matches[::HELD_OUT_EVERY]
    fitted = [match for k, match in enumerate(matches) if k % HELD_OUT_EVERY]
    if not fitted:
        return Refined(model, determined, altered)
    refined = _adjusted(colmap, start, fitted, fixed)
    helps = is_plausible(refined, focals)
    helps = helps and (by_exif is not None or _error(refined, left_out) < _error(model, left_out))
    known = determined or (by_exif is not None and helps)
    return Refined(refined if helps else model, known, altered)


def contradicts_exif(colmap: Any, model: Any, focals: Sequence[float | None]) -> bool:
    """Whether the points fit clearly worse with focal lengths by EXIF, where known, than with free ones."""
    images = sorted(model.reg_image_ids())
    free = _adjusted(colmap, model, [], own_lens=images)
    by_exif = list(focals)
    for k in images:
        camera, index = free.camera(free.image(k).camera_id), image_index(free.image(k).name)
        if by_exif[index] is None:
            by_exif[index] = camera.focal_length / max(camera.width, camera.height)
    fixed = _adjusted(colmap, _with_focals(colmap, free, by_exif), [], True)
    return _cost(fixed, free) > MIN_CONTRADICTION * _cost(free)


def with_zoomed_lenses(colmap: Any, model: Any) -> Any:
    """Return a model in which zoomed photographs have a lens of their own, or the model if there are none.

    Those that were zoomed, or cropped and enlarged, fit the others' lens less exactly, from a wrong place.
    """
    images = sorted(model.reg_image_ids())
    if len(images) < MIN_TO_COMPARE or len(model.cameras) == len(images):
        return model
    alone = _adjusted(colmap, model, [], own_lens=images)
    focals = {k: alone.camera(alone.image(k).camera_id).focal_length for k in images}
    zoomed = []
    for k in images:
        lens = model.image(k).camera_id
        usual = np.median([focals[i] for i in images if model.image(i).camera_id == lens])
        if abs(np.log(focals[k] / usual)) > np.log(MIN_ZOOM):
            zoomed.append(k)
    if not zoomed:
        return model
    separate = _adjusted(colmap, model, [], own_lens=zoomed)
    shared = _cost(_adjusted(colmap, model, []))
    return separate if MIN_INCREASE * _cost(separate) < shared else model


def with_cropped_lenses(colmap: Any, model: Any) -> Any:
    """Return a model in which cropped photographs have their own principal point, or the same model.

    Only a photograph that shares its lens with no other is tried: most photographs of one size share one. In
    a crop off centre, the principal point is not the centre of the picture. If it is assumed there, the
    photograph fits only from a wrong place, and with few photographs all focal lengths adapt to it.
    """
    images = sorted(model.reg_image_ids())
    lenses = Counter(model.image(k).camera_id for k in images)
    if max(lenses.values()) < MIN_TO_COMPARE - 1:
        return model
    for lens in (k for k in sorted(lenses) if lenses[k] == 1):
        costs = {}
        for start in _STARTS:
            moved = _centred(colmap, model, lens, start)
            costs[_cost(moved, model)] = moved
        least = min(costs)
        moved = costs[least]
        falls = MIN_FALL * least < _cost(_adjusted(colmap, model, []), model)
        if falls and max(abs(_shift(moved.camera(lens)))) > MIN_SHIFT:
            model = moved
    return model


def _centred(colmap: Any, model: Any, lens: int, start: float) -> Any:
    """A model after adjustment of the principal point of a lens, from focal lengths times a factor."""
    moved = _adjusted(colmap, _zoomed(colmap, model, start), [], True)
    # In turn, because COLMAP frees the principal points of all lenses whose focal length is free.
    for _ in range(_ROUNDS):
        moved = _adjusted(colmap, _adjusted(colmap, moved, [], centre_of=lens), [])
    return moved


def _shift(camera: Any) -> NDArray[np.float64]:
    """Distance of the principal point from the centre, in units of width and height."""
    shift: NDArray[np.float64] = camera.params[1:3] / [camera.width, camera.height] - 0.5
    return shift


def _altered(given: Any, model: Any) -> tuple[int, ...]:
    """Indices of photographs with a lens that `given` lacks, of another focal length or off centre."""
    images = sorted(map(model.image, model.reg_image_ids()), key=lambda image: image.name)
    lenses = [model.camera(image.camera_id) for image in images]
    usual = np.median([camera.focal_length for camera in lenses])
    return tuple(
        image_index(image.name)
        for image, camera in zip(images, lenses, strict=True)
        if max(abs(_shift(camera))) > MIN_SHIFT
        or (
            camera.camera_id not in given.cameras
            and abs(np.log(camera.focal_length / usual)) > np.log(MIN_ZOOM)
        )
    )


def _determines_focal(colmap: Any, model: Any) -> bool:
    """Whether focal lengths longer or shorter by one factor increase the cost clearly."""
    costs = [
        _cost(_adjusted(colmap, _zoomed(colmap, model, factor), [], True))
        for factor in (1.0, OTHER_FOCAL, 1 / OTHER_FOCAL)
    ]
    return min(costs[1:]) > MIN_INCREASE * costs[0]


def _zoomed(colmap: Any, model: Any, factor: float) -> Any:
    """A copy of a model with its focal lengths multiplied."""
    changed = colmap.Reconstruction(model)
    for camera in changed.cameras.values():
        camera.params = [factor * camera.focal_length, *camera.params[1:]]
    return changed


def _with_focals(colmap: Any, model: Any, focals: Sequence[float | None]) -> Any:
    """A copy of a model with focal lengths by index, or None if one is unknown."""
    changed = colmap.Reconstruction(model)
    for key in model.reg_image_ids():
        image = model.image(key)
        focal, camera = focals[image_index(image.name)], changed.camera(image.camera_id)
        if focal is None:
            return None
        camera.params = [focal * max(camera.width, camera.height), *camera.params[1:]]
    return changed


def _cost(model: Any, other: Any = None) -> float:
    """Sum of the soft L1 loss of the errors of all points.

    Points of another model that were dropped count with an error of `MAX_ERROR` in two photographs.
    """
    errors = [point.error for point in model.points3D.values()]
    lengths = [point.track.length() for point in model.points3D.values()]
    if other is not None:
        errors.append(MAX_ERROR)
        lengths.append(2 * (other.num_points3D() - model.num_points3D()))
    return float(np.dot(lengths, np.sqrt(1 + np.square(errors) / LOSS_SCALE**2) - 1))


def _adjusted(
    colmap: Any,
    model: Any,
    matches: Sequence[Match],
    fixed_focal: bool = False,
    own_lens: Sequence[int] = (),
    centre_of: int | None = None,
) -> Any:
    """A copy of a model after bundle adjustment; its points are those of the model that agree.

    Args:
        own_lens: images by id that do not share a lens.
        centre_of: lens by id whose principal point is free too, while the other lenses are fixed.
    """
    adjusted = colmap.Reconstruction()
    lens_of = _lenses(colmap, model, own_lens)
    for camera in {camera.camera_id: camera for camera in lens_of.values()}.values():
        adjusted.add_camera_with_trivial_rig(camera)
    points = [point for _, point in sorted(model.points3D.items())]
    tracks = [
        [(e.image_id, model.image(e.image_id).points2D[e.point2D_idx].xy) for e in p.track.elements]
        for p in points
    ]
    tracks += [list(match.seen.items()) for match in matches]
    keypoints: dict[int, list[Any]] = {k: [] for k in model.reg_image_ids()}
    elements = []
    for track in tracks:
        elements.append([colmap.TrackElement(k, len(keypoints[k])) for k, _ in track])
        for k, place in track:
            keypoints[k].append(place)
    for k, places in keypoints.items():
        image = model.image(k)
        copied = colmap.Image(
            name=image.name,
            keypoints=np.array(places),
            camera_id=lens_of[k].camera_id,
            image_id=k,
        )
        adjusted.add_image_with_trivial_frame(copied, image.cam_from_world())
    positions = [point.xyz for point in points] + [match.point for match in matches]
    for position, seen in zip(positions, elements, strict=True):
        adjusted.add_point3D(position, colmap.Track(elements=seen))
    # All free: COLMAP's own choice may fix three points, which has two constraints too many.
    everything = colmap.BundleAdjustmentConfig()
    for k in keypoints:
        everything.add_image(k)
    options = _options(colmap, fixed_focal)
    if centre_of is not None:
        options.refine_principal_point = True
        for lens in set(adjusted.cameras).difference([centre_of]):
            everything.set_constant_cam_intrinsics(lens)
    colmap.create_default_bundle_adjuster(options, everything, adjusted).solve()
    adjusted.update_point_3d_errors()
    for number, key in enumerate(sorted(adjusted.point3D_ids())):
        point = adjusted.point3D(key)
        if number < len(points) and point.error <= MAX_ERROR:
            point.color = points[number].color
        else:
            adjusted.delete_point3D(key)
    return adjusted


def _lenses(colmap: Any, model: Any, own_lens: Sequence[int]) -> dict[int, Any]:
    """Camera of each image by id; new copies for some."""
    lenses = {k: model.camera(model.image(k).camera_id) for k in sorted(model.reg_image_ids())}
    unused = max(model.cameras) + 1
    for number, k in enumerate(own_lens, start=unused):
        lenses[k] = colmap.Camera(lenses[k].todict() | {"camera_id": number})
    return lenses


def _options(colmap: Any, fixed_focal: bool) -> Any:
    options = colmap.BundleAdjustmentOptions(print_summary=False)
    options.refine_focal_length = not fixed_focal
    options.ceres.loss_function_type = colmap.LossFunctionType.SOFT_L1
    options.ceres.loss_function_scale = LOSS_SCALE
    solver = options.ceres.solver_options
    solver.num_threads, solver.max_num_iterations = 1, _MAX_ITERATIONS
    solver.function_tolerance = _TOLERANCE
    return options


def _error(model: Any, matches: Sequence[Match]) -> float:
    """Mean distance of matches from their epipolar lines, each at most `MAX_ERROR` pixels."""
    places: dict[tuple[int, int], list[tuple[NDArray[np.float64], ...]]] = {}
    for match in matches:
        (here, corner), *others = match.seen.items()
        for there, place in others:
            places.setdefault((here, there), []).append((corner, place))
    distances = [
        sampson_distances(model, pair, *np.array(of_pair).swapaxes(0, 1))
        for pair, of_pair in places.items()
    ]
    return float(np.minimum(np.concatenate(distances), MAX_ERROR).mean())
