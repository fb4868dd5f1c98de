"""Dense matches between photographs with estimated cameras.

Depth that two photographs confirm predicts where each corner of one appears in the other. Optical flow (Lucas
and Kanade 1981) between the corner and the other photograph, warped by that depth, corrects the prediction in
both directions, so that the match does not depend on the cameras.
"""

from __future__ import annotations

from collections import Counter
from itertools import combinations
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from registry.toolkit.progress import tracked

from .views import Pictures, View, confirmed, depth_of, sampled

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray
    from torch import Tensor

    _Array = NDArray[np.float64]

MAX_PARTNERS = 4
"""Photographs that each one is matched with at least, those that share most points."""
DEPTH_SIZE, FLOW_SIZE = 320, 800
"""Longer sides of the photographs for depth and for optical flow, in pixels."""
MAX_CORNERS, MAX_CORNERS_OF_ONE = 4800, 800
"""Corners of all photographs, and of each one."""
_CORNER_QUALITY, _CORNER_DISTANCE = 0.005, 4
_WINDOW, _MAX_FLOW, _MAX_RETURN = 15, 6.0, 0.3
"""Window of the optical flow, the longest flow, and the largest error of flow there and back, in pixels."""
_BORDER = 5
"""Side, in pixels, of the window in which depth must be confirmed."""


class Match(NamedTuple):
    """A corner of one photograph, and where it appears in others.

    Args:
        point: `[3]` in the world, by the depth.
        seen: positions `[2]` in pixels of the photographs, by image id; the first one is the corner.
    """

    point: _Array
    seen: dict[int, _Array]


def dense_matches(model: Any, images: Path) -> list[Match]:
    """Match corners of the photographs of a pycolmap model.

    Args:
        images: folder of the photographs, named by index.

    Raises:
        SceneError, CameraError: a lens is not plausible.
    """
    from core_rasterizer import open_device

    device = open_device()
    small, large = (_views(model, Pictures(images, size)) for size in (DEPTH_SIZE, FLOW_SIZE))
    depths: dict[int, dict[int, Tensor]] = {here: {} for here in small}
    for here, there in tracked(_pairs(model, small), "refining"):
        depths[here][there] = depth_of(device, small[here], small[there])
        depths[there][here] = depth_of(device, small[there], small[here])
    count = min(MAX_CORNERS // max(1, len(large)), MAX_CORNERS_OF_ONE)
    matches = []
    for here, of_others in depths.items():
        hints = {
            there: (
                confirmed(small[here], small[there], depth, depths[there][here]).pixels,
                depth,
            )
            for there, depth in of_others.items()
        }
        matches += _matched(model, here, large, hints, count)
    return matches


def _views(model: Any, pictures: Pictures) -> dict[int, View]:
    points = np.array([point.xyz for _, point in sorted(model.points3D.items())]).reshape(-1, 3)
    views = {k: pictures.view(model, model.image(k), points) for k in sorted(model.reg_image_ids())}
    return {k: view for k, view in views.items() if view is not None}


def _pairs(model: Any, views: dict[int, View]) -> list[tuple[int, int]]:
    """Pairs of image ids, first < second: each with those that share most points with it."""
    shared: Counter[tuple[int, int]] = Counter()
    for point in model.points3D.values():
        seen = {element.image_id for element in point.track.elements}
        shared.update(combinations(sorted(seen & views.keys()), 2))
    pairs: set[tuple[int, int]] = set()
    for k in views:
        own = sorted((pair for pair in shared if k in pair), key=lambda pair: (-shared[pair], pair))
        pairs.update(own[:MAX_PARTNERS])
    return sorted(pairs)


def _matched(
    model: Any,
    here: int,
    views: dict[int, View],
    hints: dict[int, tuple[Tensor, Tensor]],
    count: int,
) -> list[Match]:
    """Corners of one photograph that were found in others.

    Args:
        hints: where another photograph confirms the depth of this one, and that depth, both `[h, w]`.
        count: largest number of corners.
    """
    import cv2
    import torch

    height, width = views[here].grey.shape
    masks, depths = {}, {}
    for there, (where, depth) in hints.items():
        inside = cv2.erode(
            cv2.resize(
                where.numpy().astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST
            ),
            np.ones((_BORDER, _BORDER), np.uint8),
        )
        masks[there] = np.asarray(inside, np.uint8)
        depths[there] = torch.from_numpy(cv2.resize(depth.numpy(), (width, height)))
    if not masks:
        return []
    anywhere = np.max([*masks.values()], axis=0)
    found_corners = cv2.goodFeaturesToTrack(
        *(_bytes(views[here].grey), count, _CORNER_QUALITY, _CORNER_DISTANCE), mask=anywhere
    )
    if found_corners is None:
        return []
    corners = np.asarray(found_corners, np.float32)
    columns, rows = np.rint(corners[:, 0].T).astype(int)
    own = _in_photograph(model, here, views[here], corners[:, 0].astype(np.float64) + 0.5)
    seen: list[dict[int, _Array]] = [{} for _ in corners]
    points = np.zeros((len(corners), 3))
    for there, depth in depths.items():
        moved, found = _flow(views[here], views[there], depth, corners)
        found &= masks[there][rows, columns] > 0
        world = _unprojected(views[here], depth, moved + 0.5)
        u, v, z = views[there].camera.project(world)
        found &= (z > 0).numpy()
        elsewhere = _in_photograph(model, there, views[there], torch.stack([u, v], -1).numpy())
        for k in np.flatnonzero(found):
            if not seen[k]:
                seen[k][here], points[k] = own[k], world[k].numpy()
            seen[k][there] = elsewhere[k]
    return [Match(points[k], places) for k, places in enumerate(seen) if places]


def _flow(
    here: View, there: View, depth: Tensor, corners: NDArray[np.float32]
) -> tuple[_Array, NDArray[np.bool_]]:
    """Positions `[N, 2]` of corners `[N, 1, 2]` in the other view warped to this one, and which are found.

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
            winSize=(_WINDOW, _WINDOW),
            maxLevel=1,
            flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        )
        return np.asarray(moved, np.float32), np.asarray(good) > 0

    moved, there_found = follow(first, second, corners)
    back, back_found = follow(second, first, moved)
    found = there_found & back_found
    found &= np.linalg.norm(back - corners, axis=2) < _MAX_RETURN
    found &= np.linalg.norm(moved - corners, axis=2) < _MAX_FLOW
    return moved[:, 0].astype(np.float64), found[:, 0]


def _unprojected(view: View, depth: Tensor, places: _Array) -> Tensor:
    """Points `[N, 3]` of positions `[N, 2]` in pixels, by the depth there."""
    import torch

    u, v = torch.from_numpy(places).T
    return view.camera.unproject(u, v, sampled(depth, u[None], v[None], "bilinear")[0])


def _in_photograph(model: Any, image: int, view: View, places: _Array) -> _Array:
    """Positions `[N, 2]` in the photograph, with distortion, of positions in its view."""
    camera = view.camera
    x, y = (places - [camera.cx, camera.cy]).T / np.array([[camera.fx], [camera.fy]])
    lens = model.camera(model.image(image).camera_id)
    pixels: _Array = lens.img_from_cam(np.column_stack([x, y, np.ones(len(x))]))
    return pixels


def _bytes(grey: Tensor) -> NDArray[np.uint8]:
    pixels: NDArray[np.uint8] = (grey.clamp(0, 1) * 255).round().numpy().astype(np.uint8)
    return pixels
