"""Distortion taken out of a photograph: what a pinhole camera would have seen."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ....errors import SceneError
from .lens import Lens
from .safe_pycolmap import import_pycolmap

if TYPE_CHECKING:
    from ..images.decoder import Pixels

_SCALES = (0.25, 1.75)
"""An undistorted photograph outside these multiples of the original's size comes from no real lens."""


def undistort(lens: Lens, pixels: Pixels, where: str) -> tuple[Lens, Pixels]:
    """The photograph that a pinhole camera would have taken; COLMAP's undistortion, bilinear.

    The result is cropped so that every pixel was seen (`blank_pixels` of 0), and so has another size.

    Args:
        lens: at the size of `pixels`.
        pixels: `[H, W, 3]` or `[H, W]` uint8.

    Raises:
        SceneError: the lens bends the picture more than any real one would.
    """
    import numpy as np

    if lens.is_pinhole:
        return lens, pixels
    colmap = import_pycolmap()
    camera = colmap.Camera(
        model=lens.model,
        width=int(lens.width),
        height=int(lens.height),
        params=[lens.fx, lens.fy, lens.cx, lens.cy, *lens.distortion],
    )
    bitmap, straight = colmap.undistort_image(
        colmap.UndistortCameraOptions(), colmap.Bitmap.from_array(pixels), camera
    )
    scales = (straight.width / lens.width, straight.height / lens.height)
    if min(scales) < _SCALES[0] or max(scales) > _SCALES[1]:
        raise SceneError(
            f"the lens bends the picture too much: {int(lens.width)}x{int(lens.height)} would become "
            f"{straight.width}x{straight.height}",
            where=where,
            fix="check the coefficients of distortion, or undistort the photographs beforehand",
        )
    fx, fy, cx, cy = straight.params
    result = np.asarray(bitmap.to_array(), dtype=np.uint8)
    return Lens(fx, fy, cx, cy, straight.width, straight.height), result
