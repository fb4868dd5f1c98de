"""Dense check of estimated cameras: do two photographs confirm each other's depth more than by chance?

Matches on repeated or symmetric surfaces can agree with wrong cameras, but the pictures around them do not.
A plane sweep estimates the depth of each photograph from the other one. A pixel is confirmed if its point
leads back to it through the other depth map and the windows around both look alike. Wrong cameras confirm
some pixels too, by chance. Their share is measured by the same sweep with one picture displaced across the
epipolar lines to either side, so that no point is where it should be; the larger share counts.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from registry import SceneError
from registry.toolkit.photos import Lens, undistort

from .unposed_photos import image_index, image_name

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray
    from torch import Tensor

    from core_rasterizer import Camera, Device

LEAST_ADVANTAGE = 1.5
"""Least ratio of confirmed pixels to those confirmed by chance. Of 24 correct pairs with 48 to 223 matches, up to
65 degrees apart, 20 had 1.5 to 2.8; eleven wrong ones had 0.9 to 1.3, and one that was 23 degrees off 1.45."""
LONGER_SIDE = 240
"""Longer side of the pictures that are compared, in pixels."""
PLANES = 64
DISPLACEMENT = 0.03
"""Displacement for chance, in units of the longer side; larger than a window."""
MAX_RETURN = 1.0
"""Largest distance of a confirmed pixel from where its point returns to, in pixels."""
LEAST_CORRELATION = 0.6
RADIUS = 2
"""Radius of the windows, in pixels."""
LEAST_CONTRAST = 4 / 255
"""Standard deviation of grey values in a window that can be recognized."""
RARE = 0.003
"""Share of pixels that is added to both sides of the ratio, which is not meaningful for fewer."""
_DEPTHS = (2, 98)
_DEPTH_MARGINS = (1 / 1.25, 1.5)
"""Percentiles of the depths of the pair's points, and factors that widen this range."""


class _View(NamedTuple):
    grey: Tensor
    camera: Camera
    depths: tuple[float, float]


class DenseCheck:
    """Compares photographs of one folder.

    Args:
        images: folder of the photographs, named by index.

    Attributes:
        rejected: pairs of indices that were not confirmed, first < second.
    """

    def __init__(self, images: Path) -> None:
        self._images = images
        self.rejected: set[tuple[int, int]] = set()
        self._small: dict[int, NDArray[np.uint8]] = {}

    def confirms(self, model: Any, first: int, second: int) -> bool:
        """Whether the pictures confirm the cameras of two images of a pycolmap model, by their ids."""
        if self.advantage(model, first, second) >= LEAST_ADVANTAGE:
            return True
        here, there = sorted(image_index(model.image(k).name) for k in (first, second))
        self.rejected.add((here, there))
        return False

    def advantage(self, model: Any, first: int, second: int) -> float:
        """Return the number of confirmed pixels divided by the number confirmed by chance.

        0 if the cameras share a centre, the pair has too few points, or a lens is not plausible.
        """
        from core_rasterizer import CameraError

        try:
            views = self._views(model, first, second)
        except (SceneError, CameraError):
            return 0.0
        if views is None:
            return 0.0
        here, there = views
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

    def _views(self, model: Any, first: int, second: int) -> tuple[_View, _View] | None:
        images = [model.image(first), model.image(second)]
        seen = {p.point3D_id for image in images for p in image.points2D if p.has_point3D()}
        points = np.array([model.points3D[key].xyz for key in sorted(seen)]).reshape(-1, 3)
        views = []
        for image in images:
            pose = image.cam_from_world().matrix()
            depth = points @ pose[2, :3] + pose[2, 3]
            depth = depth[depth > 0]
            if not len(depth):
                return None
            near, far = np.percentile(depth, _DEPTHS) * _DEPTH_MARGINS
            views.append(_View(*self._picture(model, image), (float(near), float(far))))
        return views[0], views[1]

    def _picture(self, model: Any, image: Any) -> tuple[Tensor, Camera]:
        """An undistorted photograph, grey `[H, W]` in [0, 1], and its camera."""
        import torch

        from registry.toolkit.drawing import grey

        pixels = self._reduced(image_index(image.name))
        lens = model.camera(image.camera_id)
        focal, cx, cy, bend = lens.params
        known = Lens(
            *(focal, focal, cx, cy, lens.width, lens.height),
            model="OPENCV",
            distortion=(bend, 0.0, 0.0, 0.0),
        )
        small = known.resized(pixels.shape[1], pixels.shape[0], image.name)
        straight, pixels = undistort(small, pixels, image.name)
        pose = np.vstack([image.cam_from_world().matrix(), [0, 0, 0, 1]])
        camera = straight.camera(pose, image.name)
        return grey(torch.from_numpy(pixels.astype(np.float32)) / 255), camera

    def _reduced(self, index: int) -> NDArray[np.uint8]:
        from PIL import Image

        if index not in self._small:
            with Image.open(self._images / image_name(index)) as opened:
                picture = opened.convert("RGB")
            scale = LONGER_SIDE / max(picture.size)
            size = (round(picture.width * scale), round(picture.height * scale))
            self._small[index] = np.array(picture.resize(size, Image.Resampling.BOX))
        return self._small[index]


def _across(here: _View, there: Camera) -> NDArray[np.float64] | None:
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


def _confirmed_share(first: _View, second: _View) -> float:
    """Share of the recognizable pixels that are confirmed, the mean of both directions."""
    import torch

    from core_rasterizer import open_device

    device = open_device()
    views = (first, second)
    depths = [_depth(device, views, 0), _depth(device, views, 1)]
    shares = []
    for here, there in ((0, 1), (1, 0)):
        camera, other = views[here].camera, views[there].camera
        u, v = camera.pixel_centers()
        ends = other.project(camera.unproject(u, v, depths[here]))
        inside = other.contains(*ends)
        back = camera.project(
            other.unproject(*ends[:2], _sampled(depths[there], *ends[:2], "nearest"))
        )
        returns = torch.hypot(back[0] - u, back[1] - v) <= MAX_RETURN
        seen = _sampled(views[there].grey.double(), *ends[:2], "bilinear")
        alike, contrast = _correlation(views[here].grey.double(), seen)
        known = inside & (contrast > LEAST_CONTRAST**2)
        confirmed = known & returns & (back[2] > 0) & (alike > LEAST_CORRELATION)
        shares.append(float(confirmed.sum()) / max(1, int(known.sum())))
    return sum(shares) / 2


def _depth(device: Device, views: tuple[_View, _View], index: int) -> Tensor:
    """Depth `[H, W]` of one view by the other."""
    import torch

    from core_rasterizer.matching import Penalties, ZnccSweep, aggregate, pick

    near, far = views[index].depths
    nearness = torch.linspace(1 / far, 1 / near, PLANES, dtype=torch.float64)
    greys, cameras = [view.grey for view in views], [view.camera for view in views]
    sweep = ZnccSweep(device, greys, cameras, nearness, radius=RADIUS)
    costs = sweep.costs(index, [1 - index])
    plane, _ = pick(device, aggregate(device, costs, greys[index], Penalties(10, 4000)), PLANES)
    return 1 / (1 / far + (1 / near - 1 / far) / (PLANES - 1) * plane.double())


def _sampled(values: Tensor, u: Tensor, v: Tensor, mode: str) -> Tensor:
    """Values `[H, W]` at positions in pixels; 0 outside."""
    import torch

    height, width = values.shape
    places = torch.stack([2 * u / width - 1, 2 * v / height - 1], dim=-1)
    return torch.nn.functional.grid_sample(
        values[None, None], places[None], mode=mode, align_corners=False
    )[0, 0]


def _correlation(first: Tensor, second: Tensor) -> tuple[Tensor, Tensor]:
    """Correlation of the windows around each pixel of two pictures, and the variance of the first."""
    import torch

    def mean(picture: Tensor) -> Tensor:
        side = 2 * RADIUS + 1
        return torch.nn.functional.avg_pool2d(
            picture[None, None], side, 1, RADIUS, count_include_pad=False
        )[0, 0]

    centers = mean(first), mean(second)
    variances = mean(first**2) - centers[0] ** 2, mean(second**2) - centers[1] ** 2
    covariance = mean(first * second) - centers[0] * centers[1]
    flat = 1e-5  # so that noise on a flat surface does not correlate
    return covariance / torch.sqrt((variances[0] + flat) * (variances[1] + flat)), variances[0]
