"""Lenses with distortion, undistortion with pycolmap, and conversion of camera poses."""

from __future__ import annotations

import math
import signal
import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from ...errors import SceneError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray

    from core_rasterizer import Camera

    from .decoder import Pixels

Distortion = Literal[
    "PINHOLE", "OPENCV", "FULL_OPENCV", "OPENCV_FISHEYE", "FOV", "THIN_PRISM_FISHEYE"
]
COEFFICIENTS: dict[Distortion, int] = {
    "PINHOLE": 0,
    "OPENCV": 4,
    "FULL_OPENCV": 8,
    "OPENCV_FISHEYE": 4,
    "FOV": 1,
    "THIN_PRISM_FISHEYE": 8,
}
"""Numbers of distortion coefficients."""
_FISHEYES = ("OPENCV_FISHEYE", "THIN_PRISM_FISHEYE")
_ROUNDED = 1e-6
"""Error of a number that is 0 or 1, at most, after matrices were inverted in float32."""
_SCALES = (0.25, 1.75)
"""Undistorted size divided by original size; real lenses stay within this range."""


@dataclass(frozen=True)
class Lens:
    """Intrinsics and distortion of a photograph; pixel centers at half integers.

    Args:
        fx, fy, cx, cy: Focal lengths and principal point, pixels of a photograph of `width` x `height`.
        model: COLMAP's name of the distortion model.
        distortion: Coefficients in COLMAP's order: OPENCV `k1 k2 p1 p2`, FULL_OPENCV the same and
            `k3 k4 k5 k6`, OPENCV_FISHEYE `k1 k2 k3 k4`, FOV `omega`, THIN_PRISM_FISHEYE `k1 k2 p1 p2 k3 k4
            sx1 sy1`.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    width: float
    height: float
    model: Distortion = "PINHOLE"
    distortion: tuple[float, ...] = ()

    @property
    def is_pinhole(self) -> bool:
        """True if straight lines stay straight. A fisheye bends them even with coefficients of 0."""
        return self.model not in _FISHEYES and not any(self.distortion)

    def fits(self, width: int, height: int) -> bool:
        """Return whether a photograph of this size has the lens's shape, to a pixel of the smaller one."""
        scale_x, scale_y = width / self.width, height / self.height
        pixel = max(1, scale_x, scale_y)
        return (
            abs(scale_x * self.height - height) <= pixel
            or abs(scale_y * self.width - width) <= pixel
        )

    def resized(self, width: int, height: int, where: str) -> Lens:
        """Return the lens for the photograph at another size.

        Raises:
            SceneError: A number is not finite or not positive, or the aspect ratio differs by more than
                a pixel of the smaller size.
        """
        self.check(where)
        if not self.fits(width, height):
            raise SceneError(
                f"the images are {width}x{height}, but the camera file was made for "
                f"{self.width:g}x{self.height:g}, which has another shape",
                where=where,
                fix="use the images that belong to this camera file, not cropped or rotated",
            )
        scale_x, scale_y = width / self.width, height / self.height
        fx, fy, cx, cy = self.fx * scale_x, self.fy * scale_y, self.cx * scale_x, self.cy * scale_y
        return Lens(fx, fy, cx, cy, width, height, self.model, self.distortion)

    def camera(self, world_to_camera: NDArray[np.float64], where: str) -> Camera:
        """Return the pinhole camera with these intrinsics at a pose `[4, 4]`.

        Raises:
            SceneError: `Camera` refuses the numbers.
        """
        import torch

        from core_rasterizer import Camera, CameraError

        pose, size = torch.from_numpy(world_to_camera), (int(self.width), int(self.height))
        try:
            return Camera(pose, self.fx, self.fy, self.cx, self.cy, *size)
        except CameraError as error:
            raise SceneError(error.what, where=where, fix=error.fix) from error

    def check(self, where: str) -> None:
        """Check the numbers.

        Raises:
            SceneError: One is not finite, or not positive where it must be, or (cx, cy) is the corner.
        """
        positive = {
            "focal length fx": self.fx,
            "focal length fy": self.fy,
            "image width": self.width,
            "image height": self.height,
        }
        problems = [
            f"the {name} is {value:g}; it must be positive"
            for name, value in positive.items()
            if not 0 < value < math.inf
        ]
        if not all(map(math.isfinite, (self.cx, self.cy, *self.distortion))):
            problems.append("a parameter of the lens is not finite")
        count, expected = len(self.distortion), COEFFICIENTS[self.model]
        if count not in (0, expected):
            problems.append(
                f"the lens {self.model} has {count} distortion coefficients, expected {expected}"
            )
        if problems:
            raise SceneError(problems[0], where=where, fix="restore the camera file")
        if 0 <= self.cx <= 1 and 0 <= self.cy <= 1:
            raise SceneError(
                f"the principal point (cx, cy) is ({self.cx:g}, {self.cy:g}), the corner of the image, as if "
                "nobody had set it, or not in pixels",
                where=where,
                fix="write cx and cy in pixels; in transforms.json, leave both out for the centre",
            )


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


def pose_from_opengl(matrix: ArrayLike, where: str) -> NDArray[np.float64]:
    """Convert a camera-to-world matrix with OpenGL axes, as in NeRF data sets, to world-to-camera.

    OpenGL's axes are right, up, backwards. The rotation is inverted by transposing; `Camera` checks that
    it is orthonormal.

    Args:
        matrix: `[4, 4]`, or `[3, 4]` without the last row.

    Raises:
        SceneError: The last row is not 0 0 0 1.
    """
    import numpy as np

    pose = np.asarray(matrix, dtype=np.float64)
    if len(pose) == 4 and not np.allclose(pose[3], [0, 0, 0, 1], rtol=0, atol=_ROUNDED):
        raise SceneError(
            f"the last row of the pose is {pose[3].tolist()}, not 0 0 0 1",
            where=where,
            fix="write 4x4 camera-to-world matrices, row by row",
        )
    return pose_from_axes(pose[:3, 0], -pose[:3, 1], -pose[:3, 2], pose[:3, 3])


def pose_from_axes(
    right: NDArray[np.float64],
    down: NDArray[np.float64],
    forward: NDArray[np.float64],
    center: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the world-to-camera matrix `[4, 4]` for a camera's axes and center, in world coordinates."""
    import numpy as np

    rotation = np.stack([right, down, forward])
    result = np.eye(4)
    result[:3, :3] = rotation
    with np.errstate(over="ignore", invalid="ignore"):  # `Camera` refuses non-finite numbers
        result[:3, 3] = -rotation @ center
    return result
