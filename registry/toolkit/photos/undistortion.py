"""Remove lens distortion with pycolmap."""

from __future__ import annotations

import signal
import threading
from typing import TYPE_CHECKING, Any

from ...errors import SceneError
from .lens import Lens

if TYPE_CHECKING:
    from .decoder import Pixels

_SCALES = (0.25, 1.75)
"""Undistorted size divided by original size; real lenses stay within this range."""


def import_pycolmap(least_severity: int = 2) -> Any:
    """Import `pycolmap` after Pillow, and keep the handler of SIGTERM.

    The wheel of pycolmap exports its own zlib. If the system's zlib, which Pillow uses, is loaded after
    it, PNG files are written damaged (Pillow 13, pycolmap 4.2). Importing pycolmap also replaces the
    handler of SIGTERM with one that prints a stack trace; called in the main thread, this function
    restores the previous one, so that a run still writes its checkpoint.

    Args:
        least_severity: Lowest severity that pycolmap logs in this process from now on: 0 information,
            1 warning, 2 error, 3 fatal.
    """
    from PIL import Image  # noqa: F401  loads the system's zlib first

    import pycolmap  # isort: skip

    handler = signal.getsignal(signal.SIGTERM)  # Python's record, which pycolmap does not update
    if handler is not None and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, handler)
    pycolmap.logging.minloglevel = max(pycolmap.logging.minloglevel, least_severity)
    return pycolmap


def undistort(lens: Lens, pixels: Pixels, where: str) -> tuple[Lens, Pixels]:
    """Resample a photograph as a pinhole camera would have taken it; COLMAP's undistortion, bilinear.

    The result is cropped to pixels that the photograph covers (`blank_pixels` of 0), so its size differs.

    Args:
        lens: Lens at the size of `pixels`.
        pixels: `[H, W, 3]` or `[H, W]` uint8.

    Raises:
        SceneError: The size changes more than with any real lens.
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
            fix="check the distortion coefficients, or undistort the photographs beforehand",
        )
    fx, fy, cx, cy = straight.params
    result = np.asarray(bitmap.to_array(), dtype=np.uint8)
    return Lens(fx, fy, cx, cy, straight.width, straight.height), result
