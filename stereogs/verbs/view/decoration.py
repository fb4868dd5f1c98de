"""Objects that the browser draws in front of and behind the image: cameras, ellipsoids, a box."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch.nn.functional import normalize

from core_rasterizer.gaussians import SH_C0
from registry.toolkit.drawing import to_bytes

if TYPE_CHECKING:
    from core_rasterizer import Gaussians

    from .picture import Box
    from .subject import Viewpoint

TRAINING_COLOR, TEST_COLOR = (230, 120, 20), (50, 110, 220)
"""Orange and blue, as in the image of `stereogs check`."""
_THUMBNAIL = 160
"""Approximate longer side of the photograph in a frustum, in pixels."""
_FRUSTUM = 0.08
"""Height of a frustum, in units of the cameras' extent."""
_BOX_COLOR = (240, 240, 240)
_BOX_WIDTH = 0.004
"""Width of the crop box's lines, in units of its diagonal."""
_CANVAS = 500.0
"""Radius of the sphere that is painted on, in the browser's units."""
MAX_ELLIPSOIDS = 10_000
"""A browser without a graphics card can still rotate so many."""


def add_cameras(
    server: Any, viewpoints: Iterable[Viewpoint], extent: float, unit: float
) -> list[Any]:
    """Add a frustum with its photograph per camera; return viser's handles.

    Args:
        extent: of the cameras, in the browser's units.
        unit: the browser's unit in world units.
    """
    return [_add_frustum(server, point, _FRUSTUM * extent, unit) for point in viewpoints]


def _add_frustum(server: Any, viewpoint: Viewpoint, size: float, unit: float) -> Any:
    camera, photograph = viewpoint.camera, viewpoint.photograph
    pose = camera.camera_to_world.numpy()
    step = max(1, max(camera.width, camera.height) // _THUMBNAIL)
    image = None if photograph is None else to_bytes(photograph[::step, ::step].contiguous())
    return server.scene.add_camera_frustum(
        f"/cameras/{viewpoint.name}",
        fov=2 * np.arctan(0.5 * camera.height / camera.fy),
        aspect=camera.width / camera.height,
        scale=size,
        thickness=0.03 * size,
        color=TEST_COLOR if viewpoint.is_test else TRAINING_COLOR,
        image=image,
        wxyz=Rotation.from_matrix(pose[:3, :3]).as_quat(scalar_first=True),
        position=pose[:3, 3] / unit,
    )


def add_box(server: Any, box: Box, unit: float) -> Any:
    """Add the edges of a box; return viser's handle. `unit`: the browser's unit in world units."""
    corners = np.array(list(product(*zip(box.low, box.high, strict=True)))) / unit
    edges = [(i, i | bit) for bit in (1, 2, 4) for i in range(8) if not i & bit]
    diagonal = float(np.linalg.norm(corners[7] - corners[0]))
    return server.scene.add_line_segments(
        "/crop_box",
        points=corners[np.array(edges)].astype(np.float32),
        colors=_BOX_COLOR,
        thickness=_BOX_WIDTH * diagonal,
    )


def add_canvas(scene: Any) -> Any:
    """Add an invisible sphere around everything, under every place of the picture; return viser's handle."""
    return scene.add_icosphere(
        "/canvas",
        radius=_CANVAS,
        subdivisions=1,
        opacity=0.0,
        side="back",
        cast_shadow=False,
        receive_shadow=False,
    )


def add_ellipsoids(
    server: Any, gaussians: Gaussians, mask: torch.Tensor | None, unit: float
) -> Any:
    """Add ellipsoids of one standard deviation for the largest, most opaque Gaussians; return viser's handle.

    Args:
        mask: `[N]` bool, the Gaussians to draw; None for all.
        unit: the browser's unit in world units.
    """
    scales, opacities = gaussians.log_scales.exp(), torch.sigmoid(gaussians.opacity_logits)
    covered = opacities * scales.prod(dim=1) ** (2 / 3)
    if mask is not None:
        covered = torch.where(mask, covered, 0.0)
    order = covered.argsort(descending=True, stable=True)
    chosen = order[: min(MAX_ELLIPSOIDS, int((covered > 0).sum()))]
    vertices, faces = _octasphere()
    return server.scene.add_batched_meshes_simple(
        "/ellipsoids",
        vertices=vertices,
        faces=faces,
        batched_wxyzs=normalize(gaussians.quaternions[chosen], dim=1).numpy(),
        batched_positions=gaussians.means[chosen].numpy() / unit,
        batched_scales=scales[chosen].numpy() / unit,
        batched_colors=to_bytes(gaussians.sh[chosen, 0] * SH_C0 + 0.5),
        cast_shadow=False,
        receive_shadow=False,
    )


def _octasphere() -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Return a unit sphere of 32 triangles: vertices `[V, 3]` and faces `[F, 3]`."""
    x, y, z = np.eye(3)
    octahedron = (
        *((x, y, z), (y, -x, z), (-x, -y, z), (-y, x, z)),
        *((y, x, -z), (-x, y, -z), (-y, -x, -z), (x, -y, -z)),
    )
    vertices: list[np.ndarray[Any, Any]] = []
    for a, b, c in octahedron:
        ab, bc, ca = ((p + q) / np.linalg.norm(p + q) for p, q in ((a, b), (b, c), (c, a)))
        vertices += [a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca]
    faces = np.arange(len(vertices), dtype=np.uint32).reshape(-1, 3)
    return np.array(vertices, np.float32), faces
