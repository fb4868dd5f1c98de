"""What the browser draws itself, in front of and behind our picture: cameras, ellipsoids, a box."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch.nn.functional import normalize

from registry.toolkit.drawing import to_bytes

if TYPE_CHECKING:
    from core_rasterizer import Gaussians

    from .picture import Box
    from .subject import Standpoint

TRAINING_COLOR, TEST_COLOR = (230, 120, 20), (50, 110, 220)
"""Orange and blue, as in the picture of `stereogs check`."""
_THUMBNAIL = 160
"""Pixels of a photograph's longer side within its frustum, about."""
_FRUSTUM = 0.08
"""Height of a frustum, in units of the cameras' extent."""
_BOX_COLOR = (240, 240, 240)
_BOX_WIDTH = 0.004
"""Of the crop box's lines, in units of its diagonal."""
MOST_ELLIPSOIDS = 10_000
"""That a browser without a graphics card can still turn."""

_SH_C0 = 0.28209479177387814
"""The constant spherical harmonic, 1 / (2 sqrt(pi))."""


def add_cameras(
    server: Any, standpoints: Iterable[Standpoint], extent: float, unit: float
) -> list[Any]:
    """Each as a frustum with its photograph; returns viser's handles.

    Args:
        extent: of the cameras, in the browser's units.
        unit: world units that are one of the browser's.
    """
    return [_add_frustum(server, one, _FRUSTUM * extent, unit) for one in standpoints]


def _add_frustum(server: Any, standpoint: Standpoint, size: float, unit: float) -> Any:
    camera, photograph = standpoint.camera, standpoint.photograph
    pose = camera.camera_to_world.numpy()
    step = max(1, max(camera.width, camera.height) // _THUMBNAIL)
    image = None if photograph is None else to_bytes(photograph[::step, ::step].contiguous())
    return server.scene.add_camera_frustum(
        f"/cameras/{standpoint.name}",
        fov=2 * np.arctan(0.5 * camera.height / camera.fy),
        aspect=camera.width / camera.height,
        scale=size,
        thickness=0.03 * size,
        color=TEST_COLOR if standpoint.is_test else TRAINING_COLOR,
        image=image,
        wxyz=Rotation.from_matrix(pose[:3, :3]).as_quat(scalar_first=True),
        position=pose[:3, 3] / unit,
    )


def add_box(server: Any, box: Box, unit: float) -> Any:
    """The twelve edges of a box; returns viser's handle.

    Args:
        unit: world units that are one of the browser's.
    """
    corners = np.array(list(product(*zip(box.low, box.high, strict=True)))) / unit
    edges = [(i, i | bit) for bit in (1, 2, 4) for i in range(8) if not i & bit]
    diagonal = float(np.linalg.norm(corners[7] - corners[0]))
    return server.scene.add_line_segments(
        "/crop_box",
        points=corners[np.array(edges)].astype(np.float32),
        colors=_BOX_COLOR,
        thickness=_BOX_WIDTH * diagonal,
    )


def add_ellipsoids(
    server: Any, gaussians: Gaussians, drawn: torch.Tensor | None, unit: float
) -> Any:
    """Gaussians as ellipsoids of one standard deviation; of many, those that cover most.

    Args:
        drawn: which are, `[N]` bool; None for all.
        unit: world units that are one of the browser's.

    Returns:
        viser's handle.
    """
    scales, opacities = gaussians.log_scales.exp(), torch.sigmoid(gaussians.opacity_logits)
    covered = opacities * scales.prod(dim=1) ** (2 / 3)
    if drawn is not None:
        covered = torch.where(drawn, covered, 0.0)
    order = covered.argsort(descending=True, stable=True)
    chosen = order[: min(MOST_ELLIPSOIDS, int((covered > 0).sum()))]
    vertices, faces = _octasphere()
    return server.scene.add_batched_meshes_simple(
        "/ellipsoids",
        vertices=vertices,
        faces=faces,
        batched_wxyzs=normalize(gaussians.quaternions[chosen], dim=1).numpy(),
        batched_positions=gaussians.means[chosen].numpy() / unit,
        batched_scales=scales[chosen].numpy() / unit,
        batched_colors=to_bytes(gaussians.sh[chosen, 0] * _SH_C0 + 0.5),
        cast_shadow=False,
        receive_shadow=False,
    )


def _octasphere() -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """A sphere of 32 triangles: vertices `[V, 3]` at distance 1, and faces `[F, 3]`."""
    corners = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
    coarse = [
        (0, 2, 4),
        (2, 1, 4),
        (1, 3, 4),
        (3, 0, 4),
        (2, 0, 5),
        (1, 2, 5),
        (3, 1, 5),
        (0, 3, 5),
    ]
    vertices: list[np.ndarray[Any, Any]] = []
    faces: list[list[int]] = []
    for triangle in coarse:
        a, b, c = corners[list(triangle)].astype(float)
        ab, bc, ca = ((p + q) / np.linalg.norm(p + q) for p, q in ((a, b), (b, c), (c, a)))
        for piece in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)):
            faces.append([len(vertices), len(vertices) + 1, len(vertices) + 2])
            vertices += piece
    return np.array(vertices, np.float32), np.array(faces, np.uint32)
