"""Dense check of estimated cameras: do two photographs confirm each other's depth more than by chance?

Matches on repeated or symmetric surfaces can agree with wrong cameras, but the pictures around them do not.
A plane sweep estimates the depth of each photograph from the other one. A pixel is confirmed if its point
leads back to it through the other depth map and the windows around both look alike. Wrong cameras confirm
some pixels too, by chance. Their share is measured by the same sweep with one picture displaced across the
epipolar lines to either side, so that no point is where it should be; the larger share counts.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from registry import SceneError

from ..unposed_photos import image_index
from .views import MAX_RETURN, Pictures, View, confirmed, depth_of

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from core_rasterizer import Camera

MIN_ADVANTAGE = 1.5
"""Least ratio of confirmed pixels to those confirmed by chance. Of 24 correct pairs up to 65 degrees apart
with 48 to 223 matches, 20 had 1.5 to 2.8. Eleven wrong ones had 0.9 to 1.3, one 23 degrees off 1.45."""
LONGER_SIDE = 240
"""Longer side of the pictures that are compared, in pixels."""
DISPLACEMENT = 0.03
"""Displacement for chance, in units of the longer side; larger than a window."""
RARE = 0.003
"""Share of pixels that is added to both sides of the ratio, which is not meaningful for fewer."""


class DenseCheck:
    """Compares photographs of one folder.

    Args:
        images: folder of the photographs, named by index.

    Attributes:
        rejected: pairs of indices that were not confirmed, first < second.
    """

    def __init__(self, images: Path) -> None:
        self.rejected: set[tuple[int, int]] = set()
        self._pictures = Pictures(images, LONGER_SIDE)

    def confirms(self, model: Any, first: int, second: int) -> bool:
        """Whether the pictures confirm the cameras of two images of a pycolmap model, by their ids."""
        if self.advantage(model, first, second) >= MIN_ADVANTAGE:
            return True
        here, there = sorted(image_index(model.image(k).name) for k in (first, second))
        self.rejected.add((here, there))
        return False

    def advantage(self, model: Any, first: int, second: int) -> float:
        """Return the number of confirmed pixels divided by the number confirmed by chance.

        0 if the cameras share a centre, the pair has too few points, or a lens is not plausible.
        """
        from core_rasterizer import CameraError

        images = [model.image(first), model.image(second)]
        seen = {p.point3D_id for image in images for p in image.points2D if p.has_point3D()}
        points = np.array([model.points3D[key].xyz for key in sorted(seen)]).reshape(-1, 3)
        try:
            here, there = (self._pictures.view(model, image, points) for image in images)
        except (SceneError, CameraError):
            return 0.0
        if here is None or there is None:
            return 0.0
        across = _across(here, there.camera)
        if across is None:
            return 0.0
        shares = []
        for sign in (0, 1, -1):
            du, dv = (sign * DISPLACEMENT * LONGER_SIDE * across).tolist()
            camera = there.camera
            moved = replace(camera, cx=camera.cx + du, cy=camera.cy + dv)
            shares.append(_confirmed_share(here, there._replace(camera=moved)))
        return (shares[0] + RARE) / (max(shares[1:]) + RARE)


def _across(here: View, there: Camera) -> NDArray[np.float64] | None:
    """Unit vector `[2]` across the epipolar line of the picture's middle; None without parallax."""
    import torch

    column, row = (torch.tensor(side / 2) for side in (here.camera.width, here.camera.height))
    u, v, z = there.project(here.camera.unproject(column, row, torch.tensor(here.depths)))
    across = np.array([float(v[0] - v[1]), float(u[1] - u[0])])
    length = float(np.linalg.norm(across))
    if not (bool((z > 0).all()) and length > MAX_RETURN):
        return None
    across /= length
    return across


def _confirmed_share(first: View, second: View) -> float:
    """Share of the recognizable pixels that are confirmed, the mean of both directions."""
    from core_rasterizer import open_device

    device = open_device()
    depths = depth_of(device, first, second), depth_of(device, second, first)
    both = confirmed(first, second, *depths), confirmed(second, first, *depths[::-1])
    shares = [float(one.pixels.sum()) / max(1, int(one.known.sum())) for one in both]
    return sum(shares) / 2
