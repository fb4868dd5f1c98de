"""What a render returns."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True, eq=False)
class Rendering:
    """One rendered view; three tensors on the CPU that take part in autograd.

    With alpha_i the opacity that Gaussian i has at a pixel and T_i the light that the Gaussians in
    front of it let through, each field sums over the Gaussians in order of depth.

    Args:
        rgb: `[H, W, 3]`, the sum of colour * alpha_i * T_i, plus the background times what light is
            left. Linear in the colours, at least 0, not clamped above.
        depth: `[H, W]`, the sum of z_i * alpha_i * T_i in world units, where z is the distance along
            the camera's axis. It is not divided by `alpha`: 0 where nothing was hit.
        alpha: `[H, W]`, the sum of alpha_i * T_i, from 0 (nothing hit) to 1 (opaque).
    """

    rgb: Tensor
    depth: Tensor
    alpha: Tensor
