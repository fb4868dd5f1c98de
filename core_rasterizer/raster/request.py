"""Input of a render apart from the Gaussians, and the filter on the image."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from ..camera import Camera
from ..errors import CameraError, GaussianError
from ..layout import CAMERA, LARGEST

NEAR_PLANE = 0.2
"""Gaussians nearer than this z-depth are culled (3DGS), world units."""
DILATION = 0.3
"""Added to the variances of every ellipse (3DGS), square pixels."""
POSED = "POSED"
"""Macro of kernels for the gradient of the pose."""


@dataclass(frozen=True)
class Footprint:
    """The filter on the image; kernels are built for it.

    Args:
        dilation: added to the variances of every ellipse, square pixels, >= 0.
        compensated: If True, the opacity falls as the ellipse grows (Mip-Splatting, Yu et al. 2024,
            eq. 10).

    Raises:
        GaussianError: a dilation that is negative or not finite.
    """

    dilation: float = DILATION
    compensated: bool = False

    def __post_init__(self) -> None:
        if not 0 <= self.dilation < LARGEST:
            raise GaussianError(
                f"the dilation is {self.dilation}; it must be at least 0 and finite",
                field="dilation",
                fix=f"use {DILATION}, or another small number of square pixels",
            )

    @property
    def macros(self) -> dict[str, float]:
        """Macros of the projection kernels."""
        compensated = {"COMPENSATED": 1} if self.compensated else {}
        return {"VARIANCE_ADDED": float(self.dilation), **compensated}


@dataclass(frozen=True)
class RenderRequest:
    """Camera, background, SH degree, opacity factors and smoothing of a render."""

    camera: Camera
    background: Sequence[float]
    sh_degree: float
    """Bands to use; a fraction weights the last: 1.5 is bands 0 and 1 and half of band 2."""
    near: float = NEAR_PLANE
    modifiers: Tensor | None = None
    """`[N]` factors of the activated opacities, or None."""
    smoothing: Tensor | None = None
    """`[N]` standard deviations of the 3D filter, world units, or None."""

    @cached_property
    def bands(self) -> int:
        """Last SH band that is read, 0 to 3."""
        return math.ceil(self.sh_degree)

    @cached_property
    def wants_pose_gradient(self) -> bool:
        """Whether a backward pass computes the gradient of `camera.world_to_camera`."""
        return self.camera.world_to_camera.requires_grad

    @cached_property
    def features(self) -> frozenset[str]:
        """Macros of the projection kernels for options that not every render uses."""
        wanted = {
            "FADED": self.sh_degree != self.bands,
            POSED: self.wants_pose_gradient,
            "SMOOTHED": self.smoothing is not None,
        }
        return frozenset(name for name, is_wanted in wanted.items() if is_wanted)

    @property
    def is_modified(self) -> bool:
        """Whether kernels read opacity factors or smoothing."""
        return self.modifiers is not None or self.smoothing is not None

    def modifier_rows(self, capacity: int, dtype: torch.dtype) -> Tensor:
        """The first row holds opacity factors; the second, if there is one, smoothing."""
        values = (self.modifiers,) if self.smoothing is None else (self.modifiers, self.smoothing)
        rows = torch.zeros(len(values), capacity, dtype=dtype)
        for row, value in zip(rows, values, strict=True):
            if value is not None:
                row[: len(value)] = value.detach()
        return rows

    def check(self, count: int) -> None:
        """Raise if this cannot be rendered with `count` Gaussians.

        Raises:
            CameraError: the image is too large to address, or the near plane is not positive.
            GaussianError: the background is not three finite numbers, the SH degree is not in 0 to 3, or
                the smoothing is not one finite number >= 0 per Gaussian.
        """
        camera = self.camera
        if camera.width * camera.height >= 2**28 or max(camera.width, camera.height) > 65535:
            raise CameraError(
                f"an image of {camera.width}x{camera.height} pixels is too large to rasterize",
                where="camera",
                fix="render it in parts, or at a lower resolution",
            )
        if not 0 < self.near < LARGEST:
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
            if not abs(value) < LARGEST:
                raise GaussianError(f"the value is {value}", field="background", index=index)
        if not 0 <= self.sh_degree <= 3:
            raise GaussianError(
                f"the SH degree is {self.sh_degree}", field="sh_degree", fix="use 0 to 3"
            )
        if self.smoothing is not None:
            _check_smoothing(self.smoothing, count)

    def camera_block(self) -> Tensor:
        """Camera and options, a `layout.CAMERA`, `[32]` float64."""
        camera = self.camera
        pose = camera.world_to_camera.detach()
        # x/z and y/z are clamped a little outside the image, where the linearized projection of a wide
        # Gaussian diverges (3DGS: 1.3 times the half field of view; here for off-centre images too).
        margin_x, margin_y = 0.15 * camera.width / camera.fx, 0.15 * camera.height / camera.fy
        block = CAMERA.packed(
            rotation=pose[:3, :3].reshape(-1).tolist(),
            translation=pose[:3, 3].tolist(),
            center=camera.center.detach().tolist(),
            fx=camera.fx,
            fy=camera.fy,
            cx=camera.cx,
            cy=camera.cy,
            limits=(
                -camera.cx / camera.fx - margin_x,
                (camera.width - camera.cx) / camera.fx + margin_x,
                -camera.cy / camera.fy - margin_y,
                (camera.height - camera.cy) / camera.fy + margin_y,
            ),
            width=camera.width,
            height=camera.height,
            near=self.near,
            background=self.background,
            last_band=self.sh_degree - self.bands + 1,
        )
        return torch.tensor(block, dtype=torch.float64)


def _check_smoothing(smoothing: Tensor, count: int) -> None:
    if tuple(smoothing.shape) != (count,):
        raise GaussianError(
            f"the shape is {tuple(smoothing.shape)}, expected ({count},)", field="smoothing"
        )
    if not count:
        return
    low, high = smoothing.detach().aminmax()  # a NaN becomes both and compares as false
    if not 0 <= low <= high < math.inf:
        bad = ~(torch.isfinite(smoothing) & (smoothing >= 0))
        index = int(bad.nonzero()[0, 0])
        raise GaussianError(
            f"the standard deviation is {float(smoothing[index])}",
            field="smoothing",
            index=index,
            fix="use finite numbers of at least 0, in world units",
        )
