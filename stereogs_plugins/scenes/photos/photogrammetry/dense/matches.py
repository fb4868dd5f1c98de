"""Dense matches between photographs with estimated cameras.

Depth that two photographs confirm predicts where each corner of one appears in the other. Optical flow (Lucas
and Kanade 1981) between the corner and the other photograph, warped by that depth, corrects the prediction in
both directions, so that the match does not depend on the cameras.
"""

from __future__ import annotations

from collections import Counter
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
import torch

from registry.toolkit.progress import tracked

from .. import thresholds
from ..colmap import Track, lens_of, pixels_of
from .depth import Pictures, confirmed, depth_of, sampled

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray
    from torch import Tensor

    from ..colmap import Array, Model
    from .depth import PinholePhoto


def dense_matches(model: Model, images: Path) -> list[Track]:
    """Match corners of the photographs of a model.

    Args:
        images: folder of the photographs, named by index.

    Returns:
        for each corner that another photograph shows: its point by the depth, its own position, and its
        positions in the others.

    Raises:
        SceneError, CameraError: a lens is not plausible.
    """
    from core_rasterizer import open_device

    device = open_device()
    small, large = (
        _photos(model, Pictures(images, size))
        for size in (thresholds.DEPTH_SIZE, thresholds.FLOW_SIZE)
    )
    depths: dict[int, dict[int, Tensor]] = {here: {} for here in small}
    for here, there in tracked(_pairs(model, small), "refining"):
        depths[here][there] = depth_of(device, small[here], small[there])
        depths[there][here] = depth_of(device, small[there], small[here])
    count = min(thresholds.MAX_CORNERS // max(1, len(large)), thresholds.MAX_CORNERS_OF_PHOTO)
    matches = []
    for here, of_others in depths.items():
        hints = {
            there: (confirmed(small[here], small[there], depth, depths[there][here]).pixels, depth)
            for there, depth in of_others.items()
        }
        matches += _matched(model, here, large, hints, count)
    return matches


def _photos(model: Model, pictures: Pictures) -> dict[int, PinholePhoto]:
    points = np.array([point.xyz for _, point in sorted(model.points3D.items())]).reshape(-1, 3)
    photos = {k: pictures.undistorted(model, k, points) for k in sorted(model.reg_image_ids())}
    return {k: photo for k, photo in photos.items() if photo is not None}


def _pairs(model: Model, photos: dict[int, PinholePhoto]) -> list[tuple[int, int]]:
    """Pairs of image ids, first < second: each with those that share most points with it."""
    shared: Counter[tuple[int, int]] = Counter()
    for point in model.points3D.values():
        seen = {element.image_id for element in point.track.elements}
        shared.update(combinations(sorted(seen & photos.keys()), 2))
    pairs: set[tuple[int, int]] = set()
    for k in photos:
        own = sorted((pair for pair in shared if k in pair), key=lambda pair: (-shared[pair], pair))
        pairs.update(own[: thresholds.MAX_PARTNERS])
    return sorted(pairs)


def _matched(
    model: Model,
    here: int,
    photos: dict[int, PinholePhoto],
    hints: dict[int, tuple[Tensor, Tensor]],
    count: int,
) -> list[Track]:
    """Corners of one photograph that were found in others.

    Args:
        hints: where another photograph confirms the depth of this one, and that depth, both `[h, w]`.
        count: largest number of corners.
    """
    import cv2

    photo = photos[here]
    height, width = photo.grey.shape
    masks, depths = {}, {}
    for there, (where, depth) in hints.items():
        inside = cv2.resize(
            where.numpy().astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST
        )
        window = np.ones((thresholds.CONFIRMED_WINDOW, thresholds.CONFIRMED_WINDOW), np.uint8)
        masks[there] = np.asarray(cv2.erode(inside, window), np.uint8)
        depths[there] = torch.from_numpy(cv2.resize(depth.numpy(), (width, height)))
    if not masks:
        return []
    anywhere = np.max([*masks.values()], axis=0)
    found_corners = cv2.goodFeaturesToTrack(
        *(_bytes(photo.grey), count, thresholds.CORNER_QUALITY, thresholds.CORNER_DISTANCE),
        mask=anywhere,
    )
    if found_corners is None:
        return []
    corners = np.asarray(found_corners, np.float32)
    columns, rows = np.rint(corners[:, 0].T).astype(int)
    own = _in_photograph(model, here, photo, corners[:, 0].astype(np.float64) + 0.5)
    seen: list[list[tuple[int, Array]]] = [[] for _ in corners]
    points = np.zeros((len(corners), 3))
    for there, depth in depths.items():
        moved, found = _flow(photo, photos[there], depth, corners)
        found &= masks[there][rows, columns] > 0
        u, v = torch.from_numpy(moved + 0.5).T
        at_corner = sampled(depth, u[None], v[None], "bilinear")[0]
        world = photo.camera.unproject(u, v, at_corner)
        u, v, z = photos[there].camera.project(world)
        found &= (z > 0).numpy()
        elsewhere = _in_photograph(model, there, photos[there], torch.stack([u, v], -1).numpy())
        for k in np.flatnonzero(found):
            if not seen[k]:
                seen[k], points[k] = [(here, own[k])], world[k].numpy()
            seen[k].append((there, elsewhere[k]))
    return [Track(points[k], places) for k, places in enumerate(seen) if places]


def _flow(
    here: PinholePhoto, there: PinholePhoto, depth: Tensor, corners: NDArray[np.float32]
) -> tuple[Array, NDArray[np.bool_]]:
    """Positions `[N, 2]` of corners `[N, 1, 2]` in the other photograph warped to this one; which are found.

    The centre of the first pixel is 0.
    """
    import cv2

    u, v = here.camera.pixel_centers()
    ends = there.camera.project(here.camera.unproject(u, v, depth))
    first, second = _bytes(here.grey), _bytes(sampled(there.grey.double(), *ends[:2], "bilinear"))

    def follow(
        start: NDArray[np.uint8], end: NDArray[np.uint8], places: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        moved, good, _ = cv2.calcOpticalFlowPyrLK(
            *(start, end, places, corners.copy()),
            winSize=(thresholds.FLOW_WINDOW, thresholds.FLOW_WINDOW),
            maxLevel=1,
            flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        )
        return np.asarray(moved, np.float32), np.asarray(good) > 0

    moved, there_found = follow(first, second, corners)
    back, back_found = follow(second, first, moved)
    found = there_found & back_found
    found &= np.linalg.norm(back - corners, axis=2) < thresholds.MAX_FLOW_ERROR
    found &= np.linalg.norm(moved - corners, axis=2) < thresholds.MAX_FLOW
    return moved[:, 0].astype(np.float64), found[:, 0]


def _in_photograph(model: Model, image: int, photo: PinholePhoto, places: Array) -> Array:
    """Positions `[N, 2]` in the photograph of an image id, with distortion, of positions without."""
    camera = photo.camera
    x, y = (places - [camera.cx, camera.cy]).T / np.array([[camera.fx], [camera.fy]])
    return pixels_of(lens_of(model, image), np.column_stack([x, y, np.ones(len(x))]))


def _bytes(grey: Tensor) -> NDArray[np.uint8]:
    pixels: NDArray[np.uint8] = (grey.clamp(0, 1) * 255).round().numpy().astype(np.uint8)
    return pixels
