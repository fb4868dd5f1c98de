"""Whether photographs fit their cameras: matched features against the epipolar geometry of the poses.

Features of a few pairs are matched without the poses, and RANSAC keeps those that one motion explains. A
match fits if the ray of the second feature lies in the plane sector between the first ray, where a point far
away would be seen, and the direction to the first camera. So a point behind the cameras does not fit.

Where the matches do not fit, the poses are also read in other ways, such as inverted or with other axes.
"""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import torch

from registry.toolkit.images import grey
from registry.toolkit.photos import import_pycolmap

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import NDArray

    from registry import View

    Array = NDArray[np.float64]

SUSPICIOUS, BETTER = 0.004, 4.0
"""From this distance on, in longer sides, a reading that makes it smaller by this factor is believed. Right
poses have 0.0003 to 0.0014 in real scenes, wrong ones 0.0085 to 1."""
UNLIKELY = 0.02
"""Distance that is reported without a better reading."""
EQUAL = 1.2
"""Readings with distances up to this multiple of the smallest are named too."""
SIDE, MOST_FEATURES = 800, 2000
"""Longer side of the photographs that are matched, pixels, and the number of their features."""
ALL_PAIRS, SOME = 4, 4
"""Photographs of which all pairs are matched; of more, this many with the next and with the nearest one."""
FEW, ENOUGH = 15, 60
"""Matches of a pair that counts, and of all pairs together, without which nothing is reported."""
STILL = 0.003
"""Matches that move less, in longer sides, may belong to a date or a frame in every photograph."""


class MatchedPair(NamedTuple):
    """Two views and the unit rays `[M, 3]` of their matches, in the axes of each camera."""

    first: int
    second: int
    rays: Array
    other_rays: Array
    focal: float  # in longer sides


class _Features(NamedTuple):
    found: tuple[Any, Any]  # pycolmap's keypoints and descriptors
    camera: Any
    pixels: Array  # [F, 2], center of the top-left pixel at (0.5, 0.5)
    rays: Array  # [F, 3]


def pose_fault(views: Sequence[View]) -> str | None:
    """Return what is wrong with the poses, and the remedy if one is known.

    None if they fit, or if too few features match. A uniform scale cannot be seen.
    """
    poses = [view.camera.world_to_camera.double().numpy() for view in views]
    return fault(matched_pairs(views), poses)


def fault(pairs: Sequence[MatchedPair], poses: Sequence[Array]) -> str | None:
    """Return what `pose_fault` returns, for world-to-camera poses `[4, 4]`."""
    if sum(len(pair.rays) for pair in pairs) < ENOUGH:
        return None
    given = _distance(pairs, poses)
    if given <= SUSPICIOUS:
        return None
    wrong = (
        "the cameras do not fit the photographs: matched features are "
        f"{given:.1%} of the image's longer side from where the poses allow them"
    )
    others = [(_distance(pairs, [read(pose) for pose in poses]), fix) for fix, read in _readings()]
    least = min(distance for distance, _ in others)
    if least < min(SUSPICIOUS, given / BETTER):
        fixes = [fix for distance, fix in others if distance <= EQUAL * least]
        return f"{wrong}, and {least:.2%} if {', or '.join(fixes[:3])}"
    if given < UNLIKELY:
        return None
    return f"{wrong}; check that each pose is that of its photograph (names, order), and the focal length"


def _distance(pairs: Sequence[MatchedPair], poses: Sequence[Array]) -> float:
    """Median over the pairs of the median distance of their matches, in longer sides."""
    medians = []
    for pair in pairs:
        relative = poses[pair.second] @ np.linalg.inv(poses[pair.first])
        angles = _angles(relative, pair.rays, pair.other_rays)
        medians.append(float(np.median(angles)) * pair.focal)
    return float(np.median(medians))


def _angles(relative: Array, rays: Array, other_rays: Array) -> Array:
    """Return `[M]` angles between the second rays and the sectors that the first rays allow, radians."""
    far = rays @ relative[:3, :3].T
    length = np.linalg.norm(relative[:3, 3])
    if length == 0:
        return _between(far, other_rays)
    near = np.broadcast_to(relative[:3, 3] / length, far.shape)
    normal = np.cross(far, near)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    off = np.einsum("mi,mi->m", other_rays, normal)
    flat = other_rays - off[:, None] * normal
    inside = np.einsum("mi,mi->m", normal, np.cross(far, flat)) >= 0
    inside &= np.einsum("mi,mi->m", normal, np.cross(flat, near)) >= 0
    edges = np.minimum(_between(far, other_rays), _between(near, other_rays))
    return np.where(inside, np.abs(np.arcsin(off.clip(-1, 1))), edges)


def _between(first: Array, second: Array) -> Array:
    across = np.linalg.norm(np.cross(first, second), axis=1)
    return np.asarray(np.arctan2(across, np.einsum("mi,mi->m", first, second)))


def _readings() -> Iterator[tuple[str, Callable[[Array], Array]]]:
    """Other ways to read a world-to-camera matrix `[4, 4]`, each with the remedy."""
    flip = np.diag([1.0, -1.0, -1.0, 1.0])
    exchanged = "world-to-camera and camera-to-world are exchanged (write the inverse of each pose"
    yield (
        "OpenCV's and OpenGL's axes are confused (multiply the second and third column of each "
        "camera-to-world matrix by -1)",
        lambda pose: flip @ pose,
    )
    yield (
        f"{exchanged}; in transforms.json then multiply its second and third column by -1)",
        lambda pose: np.asarray(np.linalg.inv(pose)),
    )
    yield f"{exchanged})", lambda pose: flip @ np.linalg.inv(flip @ pose)
    yield "quaternions are x y z w (write w first)", _w_moved_first
    yield (
        "camera centers C are given as translations (write -R C)",
        lambda pose: _pose(pose[:3, :3], -pose[:3, :3] @ pose[:3, 3]),
    )
    yield (
        "the rotations are transposed (transpose the 3x3 part of each camera-to-world matrix)",
        lambda pose: _pose(pose[:3, :3].T, pose[:3, :3].T @ pose[:3, :3].T @ pose[:3, 3]),
    )
    yield (
        "the rotations are transposed (transpose the 3x3 part of each world-to-camera matrix)",
        lambda pose: _pose(pose[:3, :3].T, pose[:3, 3]),
    )


def _pose(rotation: Array, translation: Array) -> Array:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, translation
    return pose


def _w_moved_first(pose: Array) -> Array:
    """Return the pose whose quaternion x y z w was read as w x y z."""
    from scipy.spatial.transform import Rotation

    if np.linalg.det(pose[:3, :3]) < 0:  # mirrored, which quaternions cannot be
        return pose
    read = Rotation.from_matrix(pose[:3, :3]).as_quat(scalar_first=True)
    return _pose(Rotation.from_quat(read).as_matrix(), pose[:3, 3])


def matched_pairs(views: Sequence[View]) -> list[MatchedPair]:
    """Match features of a few pairs, without their poses."""
    colmap = import_pycolmap()
    options = colmap.FeatureMatchingOptions()
    options.num_threads = 1
    matcher = colmap.FeatureMatcher.create(options, colmap.Device.cpu)
    features: dict[int, _Features] = {}
    matched = []
    for first, second in _pairs(views):
        for index in (first, second):
            if index not in features:
                features[index] = _features(colmap, views[index])
        here, there = features[first], features[second]
        found = _verified(colmap, matcher, here, there)
        if len(found) >= FEW:
            rays, other_rays = here.rays[found[:, 0]], there.rays[found[:, 1]]
            side = max(here.camera.width, here.camera.height)
            focal = here.camera.mean_focal_length() / side
            matched.append(MatchedPair(first, second, rays, other_rays, focal))
    return matched


def _pairs(views: Sequence[View]) -> list[tuple[int, int]]:
    """Pairs that probably show the same: the next photographs, and those with the nearest camera."""
    count = len(views)
    if count <= ALL_PAIRS:
        return list(combinations(range(count), 2))
    centers = np.stack([view.camera.center.numpy() for view in views])
    pairs = set()
    for index in np.linspace(0, count - 2, SOME).round().astype(int).tolist():
        distances = np.linalg.norm(centers - centers[index], axis=1)
        distances[index] = np.inf
        nearest = int(distances.argmin())
        pairs |= {(index, index + 1), (min(index, nearest), max(index, nearest))}
    return sorted(pairs)


def _features(colmap: Any, view: View) -> _Features:
    width, height = view.camera.width, view.camera.height
    scale = min(1.0, SIDE / max(width, height))
    lens = view.camera.resized(round(scale * width), round(scale * height))
    brightness = torch.nn.functional.interpolate(
        grey(view.image)[None, None].clamp(0, 1), (lens.height, lens.width), mode="area"
    )
    options = colmap.FeatureExtractionOptions()
    options.num_threads = 1
    options.sift.first_octave = 0
    options.sift.max_num_features = MOST_FEATURES
    extractor = colmap.FeatureExtractor.create(options, colmap.Device.cpu)
    found = extractor.extract_from_uint8_array(
        (255 * brightness[0, 0]).round().to(torch.uint8).numpy()
    )
    camera = colmap.Camera.create_from_model_id(
        1, colmap.CameraModelId.PINHOLE, lens.fx, lens.width, lens.height
    )
    camera.params = [lens.fx, lens.fy, lens.cx, lens.cy]
    pixels = colmap.keypoints_to_matrix(found[0])[:, :2].astype(np.float64)
    rays = np.ones((len(pixels), 3))
    rays[:, :2] = (pixels - [lens.cx, lens.cy]) / [lens.fx, lens.fy]
    return _Features(found, camera, pixels, rays / np.linalg.norm(rays, axis=1, keepdims=True))


def _verified(colmap: Any, matcher: Any, here: _Features, there: _Features) -> NDArray[np.int64]:
    """Return the indices `[M, 2]` of the matches that one motion of the camera explains."""
    if min(len(here.pixels), len(there.pixels)) < FEW:
        return np.zeros((0, 2), dtype=np.int64)
    matches = matcher.match(*here.found, *there.found)
    moved = np.linalg.norm(here.pixels[matches[:, 0]] - there.pixels[matches[:, 1]], axis=1)
    matches = matches[moved > STILL * max(here.camera.width, here.camera.height)]
    options = colmap.TwoViewGeometryOptions()
    options.ransac.random_seed = 0
    options.ransac.num_threads = 1
    geometry = colmap.estimate_calibrated_two_view_geometry(
        here.camera, here.pixels, there.camera, there.pixels, matches, options
    )
    return np.asarray(geometry.inlier_matches, dtype=np.int64).reshape(-1, 2)
