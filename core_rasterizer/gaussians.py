"""Gaussian parameters on the host, as they are optimized."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from .errors import GaussianError

SH_C0 = 0.28209479177387814
"""The constant spherical-harmonic basis function, 1 / (2 sqrt(pi))."""


def sh_coefficients(degree: int) -> int:
    """Number of spherical-harmonic coefficients of a colour channel up to `degree` (0 to 3)."""
    return (degree + 1) ** 2


@dataclass(frozen=True, eq=False)
class Gaussians:
    """N Gaussians as plain torch tensors on the CPU.

    Args:
        means: `[N, 3]` centres, world units; float32, or float64 in files and exports.
        log_scales: `[N, 3]` natural logarithms of the standard deviations along the Gaussian's axes.
        quaternions: `[N, 4]` rotations (w, x, y, z) of non-zero length; normalized on use.
        opacity_logits: `[N]`; opacity = sigmoid(logit).
        sh: `[N, K, 3]` spherical-harmonic coefficients, K = 1, 4, 9 or 16; colour = SH + 0.5.

    Raises:
        GaussianError: inconsistent shapes. Values are not checked; see `check_finite`.
    """

    means: Tensor
    log_scales: Tensor
    quaternions: Tensor
    opacity_logits: Tensor
    sh: Tensor

    def __post_init__(self) -> None:
        count = self.means.shape[0] if self.means.ndim else 0
        expected = {
            "means": (count, 3),
            "log_scales": (count, 3),
            "quaternions": (count, 4),
            "opacity_logits": (count,),
        }
        for field, shape in expected.items():
            actual = tuple(getattr(self, field).shape)
            if actual != shape:
                raise GaussianError(f"the shape is {actual}, expected {shape}", field=field)
        shape = tuple(self.sh.shape)
        if len(shape) != 3 or shape[0] != count or shape[2] != 3 or shape[1] not in (1, 4, 9, 16):
            raise GaussianError(
                f"the shape is {shape}, expected ({count}, K, 3) with K = 1, 4, 9 or 16", field="sh"
            )

    def __len__(self) -> int:
        return int(self.means.shape[0])

    @property
    def sh_degree(self) -> int:
        """Degree of `sh`, 0 to 3."""
        return math.isqrt(self.sh.shape[1]) - 1

    @property
    def needs_double(self) -> bool:
        """Whether rounding the means to float32 would move them by more than 1 % of a typical scale."""
        if self.means.dtype != torch.float64 or not len(self):
            return False
        rounding = float((self.means.float() - self.means).abs().max())
        return rounding > 0.01 * float(self.log_scales.median().exp())

    def check_finite(self) -> Gaussians:
        """Return self if every parameter is finite.

        Raises:
            GaussianError: names the first field and index that are not.
        """
        for field in ("means", "log_scales", "quaternions", "opacity_logits", "sh"):
            finite = torch.isfinite(getattr(self, field))[:, None].flatten(1).all(dim=1)
            if not finite.all():
                index = int((~finite).nonzero()[0])
                raise GaussianError("a value is not finite", field=field, index=index)
        return self

    @staticmethod
    def from_points(
        positions: Tensor,
        colors: Tensor,
        scales: Tensor,
        opacities: Tensor,
        sh_degree: int,
        quaternions: Tensor | None = None,
        sh: Tensor | None = None,
    ) -> Gaussians:
        """Create Gaussians at points.

        Args:
            positions: `[N, 3]` world units.
            colors: `[N, 3]` in [0, 1]; stored in the constant SH band as (rgb - 0.5) / C0.
            scales: `[N]` or `[N, 3]` standard deviations, world units, > 0.
            opacities: `[N]` in (0, 1).
            sh_degree: 0 to 3; bands that are not given are zero.
            quaternions: `[N, 4]` (w, x, y, z); None: no rotation.
            sh: `[N, K, 3]`, instead of the colours; bands above `sh_degree` are left out.
        """
        count = positions.shape[0]
        known = (colors[:, None] - 0.5) / SH_C0 if sh is None else sh
        coefficients = torch.zeros(count, sh_coefficients(sh_degree), 3)
        shared = min(known.shape[1], coefficients.shape[1])
        coefficients[:, :shared] = known[:, :shared]
        if quaternions is None:
            quaternions = torch.zeros(count, 4)
            quaternions[:, 0] = 1.0
        log_scales = scales.float().log()
        return Gaussians(
            means=positions.float().clone(),
            log_scales=log_scales[:, None].repeat(1, 3) if scales.ndim == 1 else log_scales,
            quaternions=quaternions.float().clone(),
            opacity_logits=torch.logit(opacities.float().clamp(1e-6, 1 - 1e-6)),
            sh=coefficients,
        )


def undefined_places(values: Tensor) -> Tensor:
    """Return the indices `[K, values.ndim]` of NaNs and infinities, in order.

    Usually one pass: values are only searched if their sum is not finite.
    """
    values = values.detach()
    if math.isfinite(values.sum()):
        return torch.empty(0, values.ndim, dtype=torch.int64)
    return (~torch.isfinite(values)).nonzero()
