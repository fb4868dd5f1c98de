"""Lenses with distortion, and conversion of camera poses."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

from ...errors import SceneError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray

    from core_rasterizer import Camera

Distortion = Literal["PINHOLE", "OPENCV", "FULL_OPENCV", "OPENCV_FISHEYE"]
_COEFFICIENTS = {"PINHOLE": 0, "OPENCV": 4, "FULL_OPENCV": 8, "OPENCV_FISHEYE": 4}


@dataclass(frozen=True)
class Lens:
    """Intrinsics and distortion of a photograph; pixel centers at half integers.

    Args:
        fx, fy, cx, cy: Focal lengths and principal point, pixels of a photograph of `width` x `height`.
        model: COLMAP's name of the distortion model.
        distortion: Coefficients in COLMAP's order: OPENCV `k1 k2 p1 p2`, FULL_OPENCV the same and
            `k3 k4 k5 k6`, OPENCV_FISHEYE `k1 k2 k3 k4`.
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
        return self.model != "OPENCV_FISHEYE" and not any(self.distortion)

    def resized(self, width: int, height: int, where: str) -> Lens:
        """Return the lens for the photograph at another size.

        Raises:
            SceneError: A number is not finite or not positive, or the aspect ratio differs by more than
                a pixel.
        """
        self._check(where)
        scale_x, scale_y = width / self.width, height / self.height
        if abs(scale_x * self.height - height) > 1 and abs(scale_y * self.width - width) > 1:
            raise SceneError(
                f"the images are {width}x{height}, but the camera file was made for "
                f"{self.width:g}x{self.height:g}, which has another shape",
                where=where,
                fix="use the images that belong to this camera file, not cropped or rotated",
            )
        return replace(
            self,
            fx=self.fx * scale_x,
            fy=self.fy * scale_y,
            cx=self.cx * scale_x,
            cy=self.cy * scale_y,
            width=width,
            height=height,
        )

    def camera(self, world_to_camera: NDArray[np.float64], where: str) -> Camera:
        """Return the pinhole camera with these intrinsics at a pose `[4, 4]`.

        Raises:
            SceneError: `Camera` refuses the numbers.
        """
        import torch

        from core_rasterizer import Camera, CameraError

        try:
            return Camera(
                torch.from_numpy(world_to_camera),
                self.fx,
                self.fy,
                self.cx,
                self.cy,
                int(self.width),
                int(self.height),
            )
        except CameraError as error:
            raise SceneError(error.what, where=where, fix=error.fix) from error

    def _check(self, where: str) -> None:
        numbers = {
            "focal length fx": self.fx,
            "focal length fy": self.fy,
            "image width": self.width,
            "image height": self.height,
        }
        problem = ""
        for name, value in numbers.items():
            if not problem and not 0 < value < math.inf:
                problem = f"the {name} is {value:g}; it must be positive"
        if not problem and not all(map(math.isfinite, (self.cx, self.cy, *self.distortion))):
            problem = "a parameter of the lens is not finite"
        if not problem and len(self.distortion) not in (0, _COEFFICIENTS[self.model]):
            problem = (
                f"the lens {self.model} has {len(self.distortion)} distortion coefficients, "
                f"expected {_COEFFICIENTS[self.model]}"
            )
        if problem:
            raise SceneError(problem, where=where, fix="restore the camera file")


def pose_from_opengl(matrix: ArrayLike, where: str) -> NDArray[np.float64]:
    """Convert a `[4, 4]` camera-to-world matrix with OpenGL axes, as in NeRF data sets, to world-to-camera.

    OpenGL's axes are right, up, backwards. The rotation is inverted by transposing; `Camera` checks that
    it is orthonormal.

    Raises:
        SceneError: The last row is not 0 0 0 1.
    """
    import numpy as np

    pose = np.asarray(matrix, dtype=np.float64)
    if not np.array_equal(pose[3], [0, 0, 0, 1]):
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
