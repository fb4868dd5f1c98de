"""Lenses: focal lengths, principal point and distortion of a photograph."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

from ....errors import SceneError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from core_rasterizer import Camera

Distortion = Literal["PINHOLE", "OPENCV", "FULL_OPENCV", "OPENCV_FISHEYE"]
_COEFFICIENTS = {"PINHOLE": 0, "OPENCV": 4, "FULL_OPENCV": 8, "OPENCV_FISHEYE": 4}


@dataclass(frozen=True)
class Lens:
    """How a camera maps directions to pixels; pixel centres at half integers.

    Args:
        fx, fy, cx, cy: pixels, of a photograph of `width` x `height`.
        model: COLMAP's name of the distortion.
        distortion: its coefficients in COLMAP's order: `k1 k2 p1 p2` of OPENCV, these and
            `k3 k4 k5 k6` of FULL_OPENCV, `k1 k2 k3 k4` of OPENCV_FISHEYE.
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
        """Whether straight lines stay straight. A fish-eye bends them even with coefficients of 0."""
        return self.model != "OPENCV_FISHEYE" and not any(self.distortion)

    def resized(self, width: int, height: int, where: str) -> Lens:
        """The lens of the photograph at another size.

        Raises:
            SceneError: a number is not finite or not positive, or the size is not the full size
                divided by one number, to a pixel.
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
        """The pinhole camera with this lens at a pose `[4, 4]`.

        Raises:
            SceneError: what `Camera` refuses.
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
        fix = "restore the camera file"
        for name, value in numbers.items():
            if not 0 < value < math.inf:
                raise SceneError(
                    f"the {name} is {value:g}; it must be positive", where=where, fix=fix
                )
        rest = (self.cx, self.cy, *self.distortion)
        if not all(map(math.isfinite, rest)):
            raise SceneError("a parameter of the lens is not finite", where=where, fix=fix)
        if len(self.distortion) not in (0, _COEFFICIENTS[self.model]):
            raise SceneError(
                f"the lens {self.model} has {len(self.distortion)} coefficients of distortion, "
                f"expected {_COEFFICIENTS[self.model]}",
                where=where,
                fix=fix,
            )
