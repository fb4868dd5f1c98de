"""Real spherical harmonics up to degree 3: the colour of a Gaussian seen from a direction.

Order and signs are those of 3D Gaussian Splatting (Kerbl et al. 2023), for scenes of other programs.
"""

from __future__ import annotations

import torch
from torch import Tensor

from .gaussians import SH_C0

SH_C1 = 0.4886025119029199
"""sqrt(3 / (4 pi)); times -y, z, -x."""

SH_C2 = (
    1.0925484305920792,  # xy
    -1.0925484305920792,  # yz
    0.31539156525252005,  # 2zz - xx - yy
    -1.0925484305920792,  # xz
    0.5462742152960396,  # xx - yy
)

SH_C3 = (
    -0.5900435899266435,  # y (3xx - yy)
    2.890611442640554,  # xyz
    -0.4570457994644658,  # y (4zz - xx - yy)
    0.3731763325901154,  # z (2zz - 3xx - 3yy)
    -0.4570457994644658,  # x (4zz - xx - yy)
    1.445305721320277,  # z (xx - yy)
    -0.5900435899266435,  # x (xx - 3yy)
)


def sh_basis(directions: Tensor, degree: int) -> Tensor:
    """Evaluate the basis functions at directions on the unit sphere.

    Args:
        directions: `[N, 3]` unit vectors (x, y, z), from the camera to the Gaussian, world axes.
        degree: 0 to 3.

    Returns:
        `[N, (degree + 1)^2]`, differentiable.
    """
    x, y, z = directions.unbind(-1)
    terms = [torch.full_like(x, SH_C0)]
    if degree >= 1:
        terms += [-SH_C1 * y, SH_C1 * z, -SH_C1 * x]
    xx, yy, zz = x * x, y * y, z * z
    if degree >= 2:
        quadratic = (x * y, y * z, 2 * zz - xx - yy, x * z, xx - yy)
        terms += [c * p for c, p in zip(SH_C2, quadratic, strict=True)]
    if degree >= 3:
        cubic = (
            y * (3 * xx - yy),
            x * y * z,
            y * (4 * zz - xx - yy),
            z * (2 * zz - 3 * xx - 3 * yy),
            x * (4 * zz - xx - yy),
            z * (xx - yy),
            x * (xx - 3 * yy),
        )
        terms += [c * p for c, p in zip(SH_C3, cubic, strict=True)]
    return torch.stack(terms, dim=-1)


def rotated_sh(sh: Tensor, rotation: Tensor) -> Tensor:
    """Return the coefficients of colours that turn with their Gaussians: new(R d) = old(d).

    A rotation does not mix the bands. The matrix of each is solved for from its values in some directions.

    Args:
        sh: `[N, K, 3]`, K = 1, 4, 9 or 16.
        rotation: `[3, 3]`, R.
    """
    generator = torch.Generator().manual_seed(0)
    directions = torch.randn(64, 3, generator=generator, dtype=torch.float64)
    directions /= directions.norm(dim=1, keepdim=True)
    degree = {1: 0, 4: 1, 9: 2, 16: 3}[sh.shape[1]]
    before = sh_basis(directions @ rotation.double(), degree)  # at R^T d
    after = sh_basis(directions, degree)
    bands = [slice(band**2, (band + 1) ** 2) for band in range(degree + 1)]
    turned = [
        torch.linalg.lstsq(after[:, band], before[:, band]).solution @ sh[:, band].double()
        for band in bands
    ]
    return torch.cat(turned, dim=1).to(sh.dtype)


def band_weights(sh_degree: float, coefficients: int) -> Tensor:
    """Weights of the coefficients for a fractional degree: 1.5 is bands 0 and 1 and half of band 2.

    Bands can fade in one after another, as the frequencies of FreeNeRF do (Yang et al. 2023).

    Args:
        sh_degree: >= 0.
        coefficients: number of coefficients, 1, 4, 9 or 16.

    Returns:
        `[coefficients]` float64, in [0, 1].
    """
    bands = torch.arange(coefficients, dtype=torch.float64).sqrt().floor()
    return (sh_degree + 1 - bands).clamp(0.0, 1.0)


def sh_color(sh: Tensor, directions: Tensor) -> Tensor:
    """Colour of each Gaussian: the series plus 0.5, clamped at 0 below (zero gradient there).

    Args:
        sh: `[N, K, 3]` coefficients, K = 1, 4, 9 or 16.
        directions: `[N, 3]` unit vectors, from the camera to the Gaussian.

    Returns:
        `[N, 3]` linear colour, at least 0, unbounded above.
    """
    degree = {1: 0, 4: 1, 9: 2, 16: 3}[sh.shape[1]]
    series = (sh_basis(directions, degree)[:, :, None] * sh).sum(dim=1)
    return (series + 0.5).clamp(min=0.0)
