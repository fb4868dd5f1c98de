"""What is to be rendered, apart from the Gaussians."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from ..camera import Camera
from ..errors import CameraError, GaussianError

NEAR_PLANE = 0.2
"""Gaussians nearer than this z-depth are culled (3DGS), world units."""

_LARGEST = 1e37
"""REAL_LARGEST of the kernels: what reaches it is not shown."""
_CAMERA_NUMBERS = 32


@dataclass(frozen=True)
class RenderRequest:
    """What is to be rendered: camera, background, SH degree, opacity factors."""

    camera: Camera
    background: Sequence[float]
    sh_degree: int
    near: float = NEAR_PLANE
    modifiers: Tensor | None = None
    """`[N]` factors of the activated opacities, or None."""

    def check(self) -> None:
        """Refuse what no image can be made of.

        Raises:
            CameraError: the image is larger than a device index can address, or the near plane is not
                in front of the camera.
            GaussianError: the background is not three finite numbers.
        """
        camera = self.camera
        if camera.width * camera.height >= 2**28 or max(camera.width, camera.height) > 65535:
            raise CameraError(
                f"an image of {camera.width}x{camera.height} pixels is too large to rasterize",
                where="camera",
                fix="render it in parts, or at a lower resolution",
            )
        if not 0 < self.near < _LARGEST:
            raise CameraError(
                f"the near plane is at {self.near}; it must be in front of the camera",
                where="near",
                fix=f"use a small positive depth, such as {NEAR_PLANE}",
            )
        if len(self.background) != 3:
            raise GaussianError(
                f"{len(self.background)} numbers given, expected 3", field="background"
            )
        for index, value in enumerate(self.background):
            if not abs(value) < _LARGEST:
                raise GaussianError(f"the value is {value}", field="background", index=index)

    def camera_block(self) -> Tensor:
        """The numbers that kernels read of a camera, in the order of `kernels/scene.cl`, `[32]` float64."""
        camera = self.camera
        pose = camera.world_to_camera
        # Ratios x/z and y/z are clamped a little outside the image, where the linearized projection of a
        # wide Gaussian would explode (3DGS: 1.3 times the half field of view; here off-centre too).
        margin_x, margin_y = 0.15 * camera.width / camera.fx, 0.15 * camera.height / camera.fy
        values = [
            *pose[:3, :3].reshape(-1).tolist(),
            *pose[:3, 3].tolist(),
            *camera.center.tolist(),
            camera.fx,
            camera.fy,
            camera.cx,
            camera.cy,
            -camera.cx / camera.fx - margin_x,
            (camera.width - camera.cx) / camera.fx + margin_x,
            -camera.cy / camera.fy - margin_y,
            (camera.height - camera.cy) / camera.fy + margin_y,
            camera.width,
            camera.height,
            self.near,
            *self.background,
        ]
        return torch.tensor(values + [0.0] * (_CAMERA_NUMBERS - len(values)), dtype=torch.float64)
