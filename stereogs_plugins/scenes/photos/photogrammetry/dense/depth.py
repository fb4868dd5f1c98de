"""Depth of photographs of a model by plane sweep, and the pixels where two photographs confirm it."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import torch

from registry.toolkit.images import grey
from registry.toolkit.photos import Lens, undistort

from .. import thresholds
from ..colmap import image_name, index_of, lens_of, mask_of

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray
    from torch import Tensor

    from core_rasterizer import Camera, Device

    from ..colmap import Array, Model


class PinholePhoto(NamedTuple):
    """A photograph without distortion.

    Args:
        grey: `[H, W]` in [0, 1].
        camera: its camera.
        depths: nearest and farthest depth.
        counts: `[H, W]` bool, False where its mask is black; None without a mask.
    """

    grey: Tensor
    camera: Camera
    depths: tuple[float, float]
    counts: Tensor | None


class Confirmed(NamedTuple):
    """Pixels `[H, W]` of a photograph whose depth another one confirms, and those that could be.

    Args:
        pixels: the point leads back to the pixel through the other depth map, and the windows around both
            look alike.
        known: pixels with contrast whose point is inside the other photograph, and that no mask excludes.
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
        self._reduced: dict[Path, NDArray[np.uint8]] = {}

    def undistorted(self, model: Model, image: int, points: Array) -> PinholePhoto | None:
        """Return the photograph of an image id; None if no point `[N, 3]` is in front of it.

        Raises:
            SceneError, CameraError: the lens is not plausible.
        """
        name = model.image(image).name
        pose = model.image(image).cam_from_world().matrix()
        depth = points @ pose[2, :3] + pose[2, 3]
        depth = depth[depth > 0]
        if not len(depth):
            return None
        near, far = np.percentile(depth, thresholds.DEPTH_PERCENTILES) * thresholds.DEPTH_MARGINS
        file = self._images / image_name(index_of(model, image))
        pixels = self._pixels(file)
        lens = lens_of(model, image)
        focal, cx, cy, distortion = lens.params
        known = Lens(
            *(focal, focal, cx, cy, lens.width, lens.height),
            model="OPENCV",
            distortion=(distortion, 0.0, 0.0, 0.0),
        )
        small = known.resized(pixels.shape[1], pixels.shape[0], name)
        straight, pixels = undistort(small, pixels, name)
        camera = straight.camera(np.vstack([pose, [0, 0, 0, 1]]), name)
        picture = grey(torch.from_numpy(pixels.astype(np.float32)) / 255)
        counts = None
        if mask_of(file).is_file():
            counts = torch.from_numpy(undistort(small, self._pixels(mask_of(file)), name)[1] == 255)
        return PinholePhoto(picture, camera, (float(near), float(far)), counts)

    def _pixels(self, file: Path) -> NDArray[np.uint8]:
        from PIL import Image

        if file not in self._reduced:
            with Image.open(file) as opened:
                picture = opened.copy()
            scale = self.longer_side / max(picture.size)
            size = (round(picture.width * scale), round(picture.height * scale))
            self._reduced[file] = np.array(picture.resize(size, Image.Resampling.BOX))
        return self._reduced[file]


def depth_of(device: Device, here: PinholePhoto, there: PinholePhoto) -> Tensor:
    """Depth `[H, W]` of one photograph by another one."""
    from core_rasterizer.matching import Penalties, ZnccSweep, aggregate, pick

    near, far = here.depths
    nearness = torch.linspace(1 / far, 1 / near, thresholds.PLANES, dtype=torch.float64)
    greys, cameras = [here.grey, there.grey], [here.camera, there.camera]
    sweep = ZnccSweep(device, greys, cameras, nearness, radius=thresholds.RADIUS)
    penalties = Penalties(*thresholds.PENALTIES)
    costs = aggregate(device, sweep.costs(0, [1]), here.grey, penalties)
    plane, _ = pick(device, costs, thresholds.PLANES)
    return 1 / (1 / far + (1 / near - 1 / far) / (thresholds.PLANES - 1) * plane.double())


def confirmed(here: PinholePhoto, there: PinholePhoto, depth: Tensor, other: Tensor) -> Confirmed:
    """Return the pixels of a photograph that its depth and that of another one confirm."""
    u, v = here.camera.pixel_centers()
    ends = there.camera.project(here.camera.unproject(u, v, depth))
    inside = there.camera.contains(*ends)
    back = here.camera.project(
        there.camera.unproject(*ends[:2], sampled(other, *ends[:2], "nearest"))
    )
    returns = torch.hypot(back[0] - u, back[1] - v) <= thresholds.MAX_RETURN
    seen = sampled(there.grey.double(), *ends[:2], "bilinear")
    alike, contrast = _correlation(here.grey.double(), seen)
    known = inside & (contrast > thresholds.MIN_CONTRAST**2)
    if here.counts is not None:
        known &= here.counts
    if there.counts is not None:
        known &= sampled(there.counts.double(), *ends[:2], "nearest") > 0
    return Confirmed(known & returns & (back[2] > 0) & (alike > thresholds.MIN_CORRELATION), known)


def sampled(values: Tensor, u: Tensor, v: Tensor, mode: str) -> Tensor:
    """Values `[H, W]` at positions in pixels, each `[A, B]`; 0 outside."""
    height, width = values.shape
    places = torch.stack([2 * u / width - 1, 2 * v / height - 1], dim=-1)
    return torch.nn.functional.grid_sample(
        values[None, None], places[None], mode=mode, align_corners=False
    )[0, 0]


def _correlation(first: Tensor, second: Tensor) -> tuple[Tensor, Tensor]:
    """Correlation of the windows around each pixel of two pictures, and the variance of the first."""
    radius, flat = thresholds.RADIUS, thresholds.FLAT_VARIANCE

    def mean(picture: Tensor) -> Tensor:
        return torch.nn.functional.avg_pool2d(
            picture[None, None], 2 * radius + 1, 1, radius, count_include_pad=False
        )[0, 0]

    centers = mean(first), mean(second)
    variances = mean(first**2) - centers[0] ** 2, mean(second**2) - centers[1] ** 2
    covariance = mean(first * second) - centers[0] * centers[1]
    return covariance / torch.sqrt((variances[0] + flat) * (variances[1] + flat)), variances[0]
