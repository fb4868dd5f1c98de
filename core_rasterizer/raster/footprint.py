"""What is added to a Gaussian's ellipse on the image, because a pixel is not a point."""

from __future__ import annotations

from dataclasses import dataclass

from ..errors import GaussianError

DILATION = 0.3
"""Added to the variances of every ellipse (3DGS), square pixels."""

_LARGEST = 1e37
"""REAL_LARGEST of the kernels: no variance reaches it."""


@dataclass(frozen=True)
class Footprint:
    """The filter on the image; kernels are built for it.

    Args:
        dilation: added to the variances of every ellipse, square pixels, >= 0.
        compensated: whether the opacity falls as the ellipse grows (Mip-Splatting, Yu et al. 2024,
            eq. 10).

    Raises:
        GaussianError: a dilation that is negative or not finite.
    """

    dilation: float = DILATION
    compensated: bool = False

    def __post_init__(self) -> None:
        if not 0 <= self.dilation < _LARGEST:
            raise GaussianError(
                f"the dilation is {self.dilation}; it must be at least 0 and finite",
                field="dilation",
                fix=f"use {DILATION}, or another small number of square pixels",
            )

    @property
    def macros(self) -> dict[str, float]:
        """What the projection kernels must be built with."""
        compensated = {"COMPENSATED": 1} if self.compensated else {}
        return {"VARIANCE_ADDED": float(self.dilation), **compensated}
