"""Photographs of a COLMAP model without distortion, and their depth by plane sweep where two confirm it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from registry.toolkit.photos import Lens, undistort

from ..unposed_photos import image_index, image_name

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray
    from torch import Tensor

    from core_rasterizer import Camera, Device

PLANES = 64
MAX_RETURN = 1.0
"""Largest distance of a confirmed pixel from where its point returns to, in pixels."""
MIN_CORRELATION = 0.6
RADIUS = 2
"""Radius of the windows, in pixels."""
MIN_CONTRAST = 4 / 255
"""Standard deviation of grey values in a window that can be recognized."""
_DEPTHS = (2, 98)
_DEPTH_MARGINS = (1 / 1.25, 1.5)
"""Percentiles of the depths of points, and factors that widen this range."""


class View(NamedTuple):
    """A photograph without distortion.

    Args:
        grey: `[H, W]` in [0, 1].
        camera: its camera.
        depths: nearest and farthest depth.
    """

    grey: Tensor
    camera: Camera
    depths: tuple[float, float]


class Confirmed(NamedTuple):
    """Pixels `[H, W]` of a view whose depth another one confirms, and those that could be.

    Args:
        pixels: the point leads back to the pixel through the other depth map, and the windows around both
            look alike.
        known: pixels with contrast whose point is inside the other view.
    """

    pixels: Tensor
    known: Tensor


class Pictures:
    """Photographs of a folder at one size.

    Args:
        images: folder of the photographs, named by index.
        longer_side: in pixels after resizing. Optical flow is more exact in enlarged photographs.
    """

    def __init__(self, images: Path, longer_side: int) -> None:
        self.longer_side = longer_side
        self._images = images
        self._reduced: dict[int, NDArray[np.uint8]] = {}

    def view(self, model: Any, image: Any, points: NDArray[np.float64]) -> View | None:
        """Return the view of an image of a pycolmap model; None if no point `[N, 3]` is in front of it.

        Raises:
            SceneError, CameraError: the lens is not plausible.
        """
        import torch

        from registry.toolkit.images import grey

        pose = image.cam_from_world().matrix()
        depth = points @ pose[2, :3] + pose[2, 3]
        depth = depth[depth > 0]
        if not len(depth):
            return None
        near, far = np.percentile(depth, _DEPTHS) * _DEPTH_MARGINS
        pixels = self._pixels(image_index(image.name))
        lens = model.camera(image.camera_id)
        focal, cx, cy, bend = lens.params
        known = Lens(
            *(focal, focal, cx, cy, lens.width, lens.height),
            model="OPENCV",
            distortion=(bend, 0.0, 0.0, 0.0),
        )
        small = known.resized(pixels.shape[1], pixels.shape[0], image.name)
        straight, pixels = undistort(small, pixels, image.name)
        camera = straight.camera(np.vstack([pose, [0, 0, 0, 1]]), image.name)
        picture = grey(torch.from_numpy(pixels.astype(np.float32)) / 255)
        return View(picture, camera, (float(near), float(far)))

    def _pixels(self, index: int) -> NDArray[np.uint8]:
        from PIL import Image

        if index not in self._reduced:
            with Image.open(self._images / image_name(index)) as opened:
                picture = opened.convert("RGB")
            scale = self.longer_side / max(picture.size)
            size = (round(picture.width * scale), round(picture.height * scale))
            self._reduced[index] = np.array(picture.resize(size, Image.Resampling.BOX))
        return self._reduced[index]


def depth_of(device: Device, here: View, there: View) -> Tensor:
    """Depth `[H, W]` of one view by another one."""
    import torch

    from core_rasterizer.matching import Penalties, ZnccSweep, aggregate, pick

    near, far = here.depths
    nearness = torch.linspace(1 / far, 1 / near, PLANES, dtype=torch.float64)
    greys, cameras = [here.grey, there.grey], [here.camera, there.camera]
    sweep = ZnccSweep(device, greys, cameras, nearness, radius=RADIUS)
    costs = sweep.costs(0, [1])
    plane, _ = pick(device, aggregate(device, costs, here.grey, Penalties(10, 4000)), PLANES)
    return 1 / (1 / far + (1 / near - 1 / far) / (PLANES - 1) * plane.double())


def confirmed(here: View, there: View, depth: Tensor, other: Tensor) -> Confirmed:
    """Return the pixels of a view that its depth and that of another view confirm."""
    import torch

    u, v = here.camera.pixel_centers()
    ends = there.camera.project(here.camera.unproject(u, v, depth))
    inside = there.camera.contains(*ends)
    back = here.camera.project(
        there.camera.unproject(*ends[:2], sampled(other, *ends[:2], "nearest"))
    )
    returns = torch.hypot(back[0] - u, back[1] - v) <= MAX_RETURN
    seen = sampled(there.grey.double(), *ends[:2], "bilinear")
    alike, contrast = _correlation(here.grey.double(), seen)
    known = inside & (contrast > MIN_CONTRAST**2)
    return Confirmed(known & returns & (back[2] > 0) & (alike > MIN_CORRELATION), known)


def sampled(values: Tensor, u: Tensor, v: Tensor, mode: str) -> Tensor:
    """Values `[H, W]` at positions in pixels, each `[A, B]`; 0 outside."""
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
