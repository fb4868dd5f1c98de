"""The pinhole camera: world-to-camera pose, focal lengths, principal point, image size."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from .errors import CameraError


@dataclass(frozen=True, eq=False)
class _Pinhole:
    world_to_camera: Tensor
    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int


class Camera(_Pinhole):
    """A pinhole camera without distortion; immutable, but `dataclasses.replace` works.

    Camera axes are OpenCV's: +x right, +y down, +z forward. Pixel centres lie at half integers: the
    centre of the top-left pixel is (0.5, 0.5), and an ideal centred camera has cx = width / 2.

    Args:
        world_to_camera: `[4, 4]` rigid transform from world to camera coordinates, anything that
            torch can convert to a tensor. Stored as a float64 copy on the CPU that stays in autograd:
            if it requires a gradient, `backward` of a render computes it (`rasterize`).
        fx, fy: focal lengths in pixels, > 0.
        cx, cy: principal point in pixels; may lie outside the image.
        width, height: image size in pixels, >= 1.

    Raises:
        CameraError: a value is not finite, a focal length or size is not positive, or the upper-left
            3x3 block is not a rotation (to 1e-3).
    """

    def __init__(
        self,
        world_to_camera: Any,
        fx: float,
        fy: float,
        cx: float,
        cy: float,
        width: int,
        height: int,
    ) -> None:
        super().__init__(
            _as_pose(world_to_camera),
            _focal("fx", fx),
            _focal("fy", fy),
            _finite("cx", cx),
            _finite("cy", cy),
            _size("width", width),
            _size("height", height),
        )

    @classmethod
    def centered(cls, world_to_camera: Any, focal: float, width: int, height: int) -> Camera:
        """A camera with square pixels and the principal point at the image centre.

        Args:
            world_to_camera: `[4, 4]`, as above.
            focal: focal length in pixels, > 0.
        """
        return cls(world_to_camera, focal, focal, width / 2, height / 2, width, height)

    @classmethod
    def look_at(
        cls,
        eye: Sequence[float],
        target: Sequence[float],
        focal: float,
        width: int,
        height: int,
        *,
        up: Sequence[float] = (0.0, -1.0, 0.0),
    ) -> Camera:
        """A `centered` camera at `eye` with `target` at the image centre.

        Args:
            up: upward direction of the image, in world coordinates, of any length.

        Raises:
            CameraError: the eye is at the target, or `up` is parallel to the viewing direction.
        """
        place, seen, upwards = (torch.as_tensor(v, dtype=torch.float64) for v in (eye, target, up))
        forward = seen - place
        right = torch.linalg.cross(forward, upwards)
        if not float(right.norm()) > 1e-9 * float(forward.norm() * upwards.norm()):
            raise CameraError(
                "the eye is at the target, or `up` is parallel to the viewing direction",
                where=f"eye {list(eye)}, target {list(target)}, up {list(up)}",
                fix="move the eye away from the target, or choose another `up`",
            )
        forward, right = forward / forward.norm(), right / right.norm()
        pose = torch.eye(4, dtype=torch.float64)
        pose[:3, :3] = torch.stack([right, torch.linalg.cross(forward, right), forward])
        pose[:3, 3] = -pose[:3, :3] @ place
        return cls.centered(pose, focal, width, height)

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
        """Project world points to the image.

        Args:
            points: `[..., 3]`, world units.

        Returns:
            u, v, z, each `[...]` float64: column and row in pixels, and z-depth in world units. Where
            z <= 0 the point is not visible, and u and v are meaningless.
        """
        pose = self.world_to_camera
        x, y, z = (points.double() @ pose[:3, :3].T + pose[:3, 3]).unbind(-1)
        return self.fx * x / z + self.cx, self.fy * y / z + self.cy, z

    def contains(
        self, u: Tensor, v: Tensor, z: Tensor | None = None, *, border: bool = False
    ) -> Tensor:
        """Which pixel positions lie in the image; `contains(*project(points))` for points.

        Args:
            u, v: column and row in pixels, `[...]`.
            z: z-depth `[...]`; if given, positions with z <= 0 are outside.
            border: If True, u = width and v = height count as inside. If False, every position inside
                falls into the pixel (floor(v), floor(u)).

        Returns:
            bool `[...]`, False for NaN.
        """
        if border:
            inside = (u >= 0) & (u <= self.width) & (v >= 0) & (v <= self.height)
        else:
            inside = (u >= 0) & (u < self.width) & (v >= 0) & (v < self.height)
        return inside if z is None else inside & (z > 0)

    def unproject(self, u: Tensor, v: Tensor, z: Tensor) -> Tensor:
        """The world points at pixel positions and depths: the inverse of `project`.

        Args:
            u, v: column and row in pixels.
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
        """The same camera moved along its +x axis: the right eye of a rectified stereo pair.

        Args:
            distance: in world units; negative moves to the left.
        """
        shift = torch.zeros(4, 4, dtype=torch.float64)
        shift[0, 3] = distance
        # Not in place: autograd keeps nothing, so backward may run through it repeatedly.
        return replace(self, world_to_camera=self.world_to_camera - shift)

    def resized(self, width: int, height: int) -> Camera:
        """The same view at another image size; focal lengths and principal point scale with it."""
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


def _finite(name: str, value: float) -> float:
    value = float(value)
    if not math.isfinite(value):
        raise CameraError(f"{name} is {value}, which is not finite", where=f"camera.{name}")
    return value


def _focal(name: str, value: float) -> float:
    value = _finite(name, value)
    if value <= 0:
        raise CameraError(
            f"the focal length {name} is {value:g}; it must be positive",
            where=f"camera.{name}",
            fix="flip the camera axes in the pose instead of using a negative focal length",
        )
    return value


def _size(name: str, value: float) -> int:
    if int(value) != value or value < 1:
        raise CameraError(
            f"the image {name} is {value}; it must be a whole number of at least 1",
            where=f"camera.{name}",
        )
    return int(value)


def _as_pose(matrix: Any) -> Tensor:
    """A float64 copy on the CPU, checked to be rigid."""
    where = "camera.world_to_camera"
    copy = torch.as_tensor(matrix).to("cpu", torch.float64).clone()
    pose = copy.detach()
    if pose.shape != (4, 4):
        raise CameraError(
            f"world_to_camera has shape {tuple(pose.shape)}; it must be (4, 4)", where=where
        )
    if not torch.isfinite(pose).all():
        raise CameraError("world_to_camera contains a value that is not finite", where=where)
    rotation = pose[:3, :3]
    residual = (rotation @ rotation.T - torch.eye(3, dtype=torch.float64)).abs().max()
    mirrored = torch.linalg.det(rotation) < 0
    if residual > 1e-3 or mirrored:
        why = "mirrored" if mirrored else f"residual {residual:.2g}"
        raise CameraError(
            f"the 3x3 block of world_to_camera is not a rotation ({why})",
            where=where,
            fix="write right-handed axes: x right, y down, z forward"
            if mirrored
            else "remove the scale from the pose",
        )
    if (pose[3] - torch.tensor([0.0, 0, 0, 1])).abs().max() > 1e-3:
        raise CameraError(
            f"the last row of world_to_camera is {pose[3].tolist()}",
            where=where,
            fix="use a rigid transform, with the last row 0 0 0 1",
        )
    return copy
