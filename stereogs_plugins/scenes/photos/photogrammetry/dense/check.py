"""Dense check of estimated cameras: do two photographs confirm each other's depth more than by chance?

Matches on repeated or symmetric surfaces can agree with wrong cameras, but the pictures around them do not.
A plane sweep estimates the depth of each photograph from the other one. A pixel is confirmed if its point
leads back to it through the other depth map and the windows around both look alike. Wrong cameras confirm
some pixels too, by chance. Their share is measured by the same sweep with one picture displaced across the
epipolar lines to either side, so that no point is where it should be; the larger share counts.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import torch

from registry import SceneError

from .. import thresholds
from ..colmap import index_of
from .depth import Pictures, confirmed, depth_of

if TYPE_CHECKING:
    from pathlib import Path

    from core_rasterizer import Camera

    from ..colmap import Array, Model
    from .depth import PinholePhoto


class DenseCheck:
    """Compares photographs of one folder.

    Args:
        images: folder of the photographs, named by index.

    Attributes:
        rejected: pairs of indices that were not confirmed, first < second.
    """

    def __init__(self, images: Path) -> None:
        self.rejected: set[tuple[int, int]] = set()
        self._pictures = Pictures(images, thresholds.CHECK_SIZE)

    def confirms(self, model: Model, first: int, second: int) -> bool:
        """Whether the pictures confirm the cameras of two images of a model, by their ids."""
        if self.advantage(model, first, second) >= thresholds.MIN_ADVANTAGE:
            return True
        here, there = sorted(index_of(model, k) for k in (first, second))
        self.rejected.add((here, there))
        return False

    def advantage(self, model: Model, first: int, second: int) -> float:
        """Return the number of confirmed pixels divided by the number confirmed by chance.

        0 if the cameras share a centre, the pair has too few points, or a lens is not plausible.
        """
        from core_rasterizer import CameraError

        images = [model.image(first), model.image(second)]
        seen = {p.point3D_id for image in images for p in image.points2D if p.has_point3D()}
        points = np.array([model.points3D[key].xyz for key in sorted(seen)]).reshape(-1, 3)
        try:
            here, there = (self._pictures.undistorted(model, k, points) for k in (first, second))
        except (SceneError, CameraError):
            return 0.0
        if here is None or there is None:
            return 0.0
        across = _across(here, there.camera)
        if across is None:
            return 0.0
        shares = []
        for sign in (0, 1, -1):
            du, dv = (sign * thresholds.DISPLACEMENT * thresholds.CHECK_SIZE * across).tolist()
            camera = there.camera
            moved = replace(camera, cx=camera.cx + du, cy=camera.cy + dv)
            shares.append(_confirmed_share(here, there._replace(camera=moved)))
        return (shares[0] + thresholds.RARE) / (max(shares[1:]) + thresholds.RARE)


def _across(here: PinholePhoto, there: Camera) -> Array | None:
    """Unit vector `[2]` across the epipolar line of the picture's middle; None without parallax."""
    column, row = (torch.tensor(side / 2) for side in (here.camera.width, here.camera.height))
    u, v, z = there.project(here.camera.unproject(column, row, torch.tensor(here.depths)))
    across = np.array([float(v[0] - v[1]), float(u[1] - u[0])])
    length = float(np.linalg.norm(across))
    if not (bool((z > 0).all()) and length > thresholds.MAX_RETURN):
        return None
    across /= length
    return across


def _confirmed_share(first: PinholePhoto, second: PinholePhoto) -> float:
    """Share of the recognizable pixels that are confirmed, the mean of both directions."""
    from core_rasterizer import open_device

    device = open_device()
    depths = depth_of(device, first, second), depth_of(device, second, first)
    both = confirmed(first, second, *depths), confirmed(second, first, *depths[::-1])
    shares = [float(way.pixels.sum()) / max(1, int(way.known.sum())) for way in both]
    return sum(shares) / 2
