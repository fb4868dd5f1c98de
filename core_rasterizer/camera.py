"""The pinhole camera: world-to-camera pose, focal lengths, principal point, image size."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from .errors import CameraError


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera without distortion.

    Camera axes are OpenCV's: +x right, +y down, +z forward. Pixel centres lie at half integers, so
    the centre of the top-left pixel is (0.5, 0.5) and an ideal centred camera has cx = width / 2.

    Args:
        world_to_camera: `[4, 4]` rigid transform from world to camera coordinates; anything that
            torch can turn into a tensor. Kept as a copy, float64 on the CPU, that stays in autograd's
            graph: where it requires a gradient, `backward` of a render gives it one (`rasterize`).
        fx, fy: focal lengths in pixels, > 0.
        cx, cy: principal point in pixels; it may lie outside the image.
        width, height: image size in pixels, >= 1.

    Raises:
        CameraError: a value is not finite, a focal length or size is not positive, or the upper-left
            3x3 block is not a rotation (to 1e-3).
    """

    world_to_camera: Tensor
    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int

    def __post_init__(self) -> None:
        pose = _as_pose(self.world_to_camera)
        object.__setattr__(self, "world_to_camera", pose)
        for name in ("fx", "fy", "cx", "cy"):
            value = float(getattr(self, name))
            if not abs(value) < float("inf"):
                raise CameraError(f"{name} is {value}, which is not finite", where=f"camera.{name}")
            object.__setattr__(self, name, value)
        for name in ("fx", "fy"):
            if getattr(self, name) <= 0:
                raise CameraError(
                    f"the focal length {name} is {getattr(self, name):g}; it must be positive",
                    where=f"camera.{name}",
                    fix="flip the camera axes in the pose instead of using a negative focal length",
                )
        for name in ("width", "height"):
            value = getattr(self, name)
            if int(value) != value or value < 1:
                raise CameraError(
                    f"the image {name} is {value}; it must be a whole number of at least 1",
                    where=f"camera.{name}",
                )
            object.__setattr__(self, name, int(value))

    @property
    def center(self) -> Tensor:
        """The camera centre in world coordinates, `[3]` float64."""
        rotation, translation = self.world_to_camera[:3, :3], self.world_to_camera[:3, 3]
        return -rotation.T @ translation

    @property
    def camera_to_world(self) -> Tensor:
        """The inverse pose, `[4, 4]` float64."""
        inverse = torch.eye(4, dtype=torch.float64)
        inverse[:3, :3] = self.world_to_camera[:3, :3].T
        inverse[:3, 3] = self.center
        return inverse

    @property
    def intrinsics(self) -> Tensor:
        """The calibration matrix K, `[3, 3]` float64, pixels."""
        return torch.tensor(
            [[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]], dtype=torch.float64
        )

    def project(self, points: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Where world points appear.

        Args:
            points: `[..., 3]`, world units.

        Returns:
            u, v, z, each `[...]` float64: column and row in pixels, the top-left pixel's centre being
            (0.5, 0.5), and z-depth in world units. Where z <= 0, nothing is seen, and u and v have
            no meaning.
        """
        pose = self.world_to_camera
        x, y, z = (points.double() @ pose[:3, :3].T + pose[:3, 3]).unbind(-1)
        return self.fx * x / z + self.cx, self.fy * y / z + self.cy, z

    def unproject(self, u: Tensor, v: Tensor, z: Tensor) -> Tensor:
        """The world points that appear at pixel positions: the inverse of `project`.

        Args:
            u, v: column and row in pixels, the top-left pixel's centre being (0.5, 0.5).
            z: z-depth, world units. The three broadcast to one shape `[...]`.

        Returns:
            `[..., 3]` float64, world units.
        """
        u, v, z = torch.broadcast_tensors(u.double(), v.double(), z.double())
        x, y = (u - self.cx) / self.fx * z, (v - self.cy) / self.fy * z
        pose = self.camera_to_world
        return torch.stack([x, y, z], dim=-1) @ pose[:3, :3].T + pose[:3, 3]

    def pixel_centers(self) -> tuple[Tensor, Tensor]:
        """Columns u and rows v of all pixel centres, `[H, W]` float64 each."""
        v, u = torch.meshgrid(
            torch.arange(self.height, dtype=torch.float64) + 0.5,
            torch.arange(self.width, dtype=torch.float64) + 0.5,
            indexing="ij",
        )
        return u, v

    def shifted_right(self, distance: float) -> Camera:
        """The same camera moved along its own +x axis: the right eye of a rectified stereo pair.

        Args:
            distance: in world units; a negative distance moves to the left.
        """
        pose = self.world_to_camera.clone()
        pose[0, 3] -= distance
        return replace(self, world_to_camera=pose)

    def resized(self, width: int, height: int) -> Camera:
        """The same view on another pixel grid; focal lengths and principal point scale with it."""
        scale_x, scale_y = width / self.width, height / self.height
        return replace(
            self,
            fx=self.fx * scale_x,
            fy=self.fy * scale_y,
            cx=self.cx * scale_x,
            cy=self.cy * scale_y,
            width=width,
            height=height,
        )


def _as_pose(matrix: Any) -> Tensor:
    pose = torch.as_tensor(matrix).to("cpu", torch.float64).clone()
    _check_rigid(pose.detach())
    return pose


def _check_rigid(pose: Tensor) -> None:
    if pose.shape != (4, 4):
        raise CameraError(
            f"world_to_camera has shape {tuple(pose.shape)}; it must be (4, 4)",
            where="camera.world_to_camera",
        )
    if not torch.isfinite(pose).all():
        raise CameraError(
            "world_to_camera contains a value that is not finite", where="camera.world_to_camera"
        )
    rotation = pose[:3, :3]
    residual = (rotation @ rotation.T - torch.eye(3, dtype=torch.float64)).abs().max()
    if residual > 1e-3 or torch.linalg.det(rotation) < 0:
        raise CameraError(
            f"the 3x3 block of world_to_camera is not a rotation (residual {residual:.2g})",
            where="camera.world_to_camera",
            fix="remove scale or mirroring from the pose",
        )
