"""The frame of training: a position and a unit that keep single precision and fixed constants valid.

Files may use any origin and unit, for example survey coordinates of millions of metres. Training runs in a
frame of its own, so that neither changes the result.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Camera, Gaussians

TYPICAL_DEPTH = 8.0
"""Geometric mean of the depth bounds in the frame of training."""
NEAREST = 0.4
"""Smallest near bound in that frame: twice the near plane of the engine."""
_STEP = 2.0**-26
"""Step of the cameras' translations in that frame, far below what a pixel shows."""
_ROUNDING = 0.382
"""Offset of the centre's rounding: symmetric scenes would often be on the border of one half."""


@dataclass(frozen=True)
class Frame:
    """Origin and unit of training: position in the file = center + unit * position in training.

    Axes keep their directions. The methods that convert compute in double precision.

    Args:
        center: origin of the frame in the file's coordinates.
        unit: length of the frame's unit in units of the file, > 0.
    """

    center: tuple[float, float, float] = (0.0, 0.0, 0.0)
    unit: float = 1.0

    @staticmethod
    def of(cameras: Sequence[Camera], bounds: tuple[float, float]) -> Frame:
        """Return the frame for training cameras and (near, far) depth bounds in the file's units.

        If the file's unit is scaled by a power of two or its origin moved without rounding, training
        receives the same bits: the centre is a multiple of a power of two.
        """
        import torch

        near, far = bounds
        unit = min(math.sqrt(near * far) / TYPICAL_DEPTH, near / NEAREST)
        step = 2.0 ** math.floor(math.log2(unit))
        mean = torch.stack([camera.center for camera in cameras]).mean(dim=0)
        x, y, z = (step * math.floor(float(value) / step + _ROUNDING) for value in mean)
        return Frame((x, y, z), unit)

    @staticmethod
    def around(gaussians: Gaussians) -> Frame:
        """Return a frame for Gaussians without training cameras."""
        means = gaussians.means.double()
        center = means.median(dim=0).values
        spread = float((means - center).norm(dim=1).median())
        x, y, z = center.tolist()
        return Frame((x, y, z), spread / TYPICAL_DEPTH if spread > 0 else 1.0)

    @property
    def _center(self) -> Tensor:
        import torch

        return torch.tensor(self.center, dtype=torch.float64)

    def camera_of_file(self, camera: Camera) -> Camera:
        """Return a camera of the file in the frame of training."""
        if self == IN_FILE:
            return camera
        rotation, translation = camera.world_to_camera[:3, :3], camera.world_to_camera[:3, 3]
        moved = (translation + rotation @ self._center) / self.unit
        # Far from the origin, poses in double precision have rounding errors, which must not change a bit.
        return _at(camera, (moved / _STEP).round() * _STEP)

    def camera_in_file(self, camera: Camera) -> Camera:
        """Return a camera of training in the file's coordinates."""
        rotation, translation = camera.world_to_camera[:3, :3], camera.world_to_camera[:3, 3]
        return _at(camera, translation * self.unit - rotation @ self._center)

    def points_of_file(self, positions: Tensor) -> Tensor:
        """Return positions of the file, `[..., 3]`, in the frame of training, float32."""
        return ((positions.double() - self._center) / self.unit).float()

    def points_in_file(self, positions: Tensor) -> Tensor:
        """Return positions of training, `[..., 3]`, in the file's coordinates, float64."""
        return self._center + self.unit * positions.double()

    def gaussians_of_file(self, gaussians: Gaussians) -> Gaussians:
        """Return Gaussians of the file in the frame of training, float32."""
        means, log_scales = self.points_of_file(gaussians.means), gaussians.log_scales
        return replace(gaussians, means=means, log_scales=log_scales - math.log(self.unit))

    def gaussians_in_file(self, gaussians: Gaussians) -> Gaussians:
        """Return Gaussians of training in the file's coordinates, their means in float64."""
        means, log_scales = self.points_in_file(gaussians.means), gaussians.log_scales
        return replace(gaussians, means=means, log_scales=log_scales + math.log(self.unit))


IN_FILE = Frame()
"""The frame of the file itself."""


def _at(camera: Camera, translation: Tensor) -> Camera:
    """Return the camera with another translation."""
    import torch

    top = torch.cat([camera.world_to_camera[:3, :3], translation[:, None]], dim=1)
    return replace(camera, world_to_camera=torch.cat([top, camera.world_to_camera[3:]]))
