"""The oracle: the renderer once more, in plain torch and float64, written to be read.

The kernels are fast; this file says what they must compute, and the tests hold them to it. It follows
3D Gaussian Splatting (Kerbl et al. 2023) with every choice made explicit by a named constant, and
torch's autograd differentiates it.

Reading order: `render` is the whole story in two calls. `project` turns each Gaussian into an
ellipse on the image, a colour and a depth; `composite` lays the ellipses over one another.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from .camera import Camera
from .rendering import Rendering
from .spherical_harmonics import band_weights, sh_color

NEAR = 0.2
"""A Gaussian whose centre has z at or below this (world units) is not drawn."""

DILATION = 0.3
"""Added to the variance of every ellipse (square pixels): a pixel is not a point."""

ALPHA_MIN = 1 / 255
"""A Gaussian touches exactly the pixels where its alpha is at least this."""

ALPHA_MAX = 0.99
"""No Gaussian takes more light than this from a pixel; above it alpha has no gradient."""

TRANSMITTANCE_MIN = 1e-4
"""A pixel stops before the Gaussian that would leave this much light, or less."""

FRUSTUM_MARGIN = 0.3
"""How far beyond the image, in half image sizes, the projection is still linearised in place."""

TILE = 16
"""Side of the pixel blocks, in pixels: keeps the list of candidates short, changes no result."""


class Ellipses(NamedTuple):
    """N Gaussians on the image, without their places."""

    covariances: Tensor
    """`[N, 2, 2]` square pixels, dilation included."""
    determinants: Tensor
    """`[N]` of the covariances."""
    undilated: Tensor
    """`[N]` determinants before dilation; 0 where the Gaussian is seen on edge."""


class Projected(NamedTuple):
    """The M visible Gaussians on the image, nearest first."""

    indices: Tensor
    """`[M]` int64: which Gaussians they are."""
    centers: Tensor
    """`[M, 2]` pixels. Its gradient is the screen-space gradient that densification reads."""
    covariances: Tensor
    """`[M, 2, 2]` square pixels, dilation included."""
    determinants: Tensor
    """`[M]` of the covariances, > 0."""
    opacities: Tensor
    """`[M]`."""
    colors: Tensor
    """`[M, 3]`, at least 0."""
    depths: Tensor
    """`[M]` z in camera coordinates, world units."""


def render(
    means: Tensor,
    quaternions: Tensor,
    scales: Tensor,
    opacities: Tensor,
    sh: Tensor,
    camera: Camera,
    background: Sequence[float] | Tensor = (0.0, 0.0, 0.0),
    *,
    near: float = NEAR,
    dilation: float = DILATION,
    compensate_dilation: bool = False,
    smoothing: Tensor | None = None,
    sh_degree: float | None = None,
) -> Rendering:
    """Render Gaussians in float64; differentiable in every tensor by autograd, the pose included.

    Args:
        means: `[N, 3]` centres, world units.
        quaternions: `[N, 4]` (w, x, y, z) of any length; zero means no rotation, without gradient.
        scales: `[N, 3]` standard deviations, world units (not their logarithms).
        opacities: `[N]` in [0, 1] (not logits).
        sh: `[N, K, 3]` spherical-harmonic coefficients, K = 1, 4, 9 or 16.
        camera: the view.
        background: `[3]` colour behind everything.
        near: Gaussians with z <= near are not drawn; world units, > 0.
        dilation: added to the variances on the image, square pixels, >= 0.
        compensate_dilation: lower the opacity by what dilation adds to the ellipse's area, as the 2D
            filter of Mip-Splatting does (Yu et al. 2024, eq. 10).
        smoothing: `[N]` standard deviations >= 0, world units, of a Gaussian filter that each Gaussian
            goes through before it is projected: the 3D filter of Mip-Splatting (eq. 9).
        sh_degree: how many bands of the colour count, the last by a fraction (`band_weights`); None is
            all.

    Returns:
        A float64 `Rendering`. A Gaussian with a parameter that is not finite is not drawn.
    """
    projected = project(
        means,
        quaternions,
        scales,
        opacities,
        sh,
        camera,
        near=near,
        dilation=dilation,
        compensate_dilation=compensate_dilation,
        smoothing=smoothing,
        sh_degree=sh_degree,
    )
    return composite(projected, camera.width, camera.height, background)


def project(
    means: Tensor,
    quaternions: Tensor,
    scales: Tensor,
    opacities: Tensor,
    sh: Tensor,
    camera: Camera,
    *,
    near: float = NEAR,
    dilation: float = DILATION,
    compensate_dilation: bool = False,
    smoothing: Tensor | None = None,
    sh_degree: float | None = None,
) -> Projected:
    """The visible Gaussians as ellipses on the image, nearest first. Arguments as in `render`."""
    means, quaternions, scales, opacities, sh = (
        t.double() for t in (means, quaternions, scales, opacities, sh)
    )
    if sh_degree is not None:
        sh = sh * band_weights(sh_degree, sh.shape[1])[:, None]
    # The first look decides who is visible; the second, at those alone, is the one that autograd
    # sees. So a Gaussian that overflows or lies behind the camera leaves no NaN in the gradient.
    with torch.no_grad():
        points, ellipses, strengths = _seen(
            means, quaternions, scales, opacities, camera, dilation, compensate_dilation, smoothing
        )
        finite = _finite(means, quaternions, scales, opacities, sh)
        in_front = (points[:, 2] > near) & (strengths >= ALPHA_MIN)
        has_area = torch.isfinite(ellipses.determinants) & (ellipses.determinants > 0)
        visible = (finite & in_front & has_area).nonzero()[:, 0]
        # Stable, so equal depths keep the order of their indices.
        indices = visible[torch.sort(points[visible, 2], stable=True).indices]
    points, ellipses, strengths = _seen(
        means[indices],
        quaternions[indices],
        scales[indices],
        opacities[indices],
        camera,
        dilation,
        compensate_dilation,
        None if smoothing is None else smoothing[indices],
    )
    directions = means[indices] - camera.center
    return Projected(
        indices=indices,
        centers=_to_pixels(points, camera),
        covariances=ellipses.covariances,
        determinants=ellipses.determinants,
        opacities=strengths,
        colors=sh_color(sh[indices], directions / directions.norm(dim=1, keepdim=True)),
        depths=points[:, 2],
    )


def composite(
    projected: Projected,
    width: int,
    height: int,
    background: Sequence[float] | Tensor = (0.0, 0.0, 0.0),
) -> Rendering:
    """Lay the ellipses over one another, front to back, and the background behind them."""
    behind = torch.as_tensor(background, dtype=torch.float64)
    reach = _reach(projected.covariances.detach(), projected.opacities.detach())
    rows = []
    for top in range(0, height, TILE):
        bottom = min(top + TILE, height)
        row = []
        for left in range(0, width, TILE):
            right = min(left + TILE, width)
            near_tile = _touching(projected.centers.detach(), reach, left, right, top, bottom)
            row.append(_composite_tile(projected, near_tile, left, right, top, bottom))
        rows.append(torch.cat(row, dim=1))
    image = torch.cat(rows, dim=0)
    rgb, depth, alpha = image[..., :3], image[..., 3], image[..., 4]
    return Rendering(rgb=rgb + (1 - alpha)[..., None] * behind, depth=depth, alpha=alpha)


def _seen(
    means: Tensor,
    quaternions: Tensor,
    scales: Tensor,
    opacities: Tensor,
    camera: Camera,
    dilation: float,
    compensate_dilation: bool,
    smoothing: Tensor | None,
) -> tuple[Tensor, Ellipses, Tensor]:
    """Points in camera coordinates `[N, 3]`, ellipses, and opacities after both filters `[N]`."""
    points = _to_camera(means, camera)
    if smoothing is not None:
        scales, opacities = _smoothed(scales, opacities, smoothing.detach().double())
    ellipses = _ellipses(points, quaternions, scales, camera, dilation)
    if compensate_dilation:
        opacities = opacities * torch.sqrt(ellipses.undilated / ellipses.determinants)
    return points, ellipses, opacities


def _finite(*parameters: Tensor) -> Tensor:
    """Which Gaussians have finite numbers only, bool `[N]`."""
    return torch.isfinite(torch.cat([t[..., None].flatten(1) for t in parameters], 1)).all(1)


def _smoothed(scales: Tensor, opacities: Tensor, smoothing: Tensor) -> tuple[Tensor, Tensor]:
    """Scales and opacities of Gaussians convolved with a Gaussian of the deviation `smoothing`.

    Variances add up; the opacity falls as the volume grows, so that the mass stays (Mip-Splatting, eq. 9).
    """
    filtered = (smoothing > 0)[:, None]
    # A stand-in where nothing is filtered: the square root has no slope at zero.
    deviations = torch.where(filtered, smoothing[:, None], 1.0)
    widened = torch.where(filtered, torch.sqrt(scales**2 + deviations**2), scales)
    shrinkage = torch.where(filtered, scales / torch.where(filtered, widened, 1.0), 1.0)
    return widened, opacities * shrinkage.prod(1)


def _to_camera(means: Tensor, camera: Camera) -> Tensor:
    rotation, translation = camera.world_to_camera[:3, :3], camera.world_to_camera[:3, 3]
    return means @ rotation.T + translation


def _to_pixels(points: Tensor, camera: Camera) -> Tensor:
    x, y, z = points.unbind(1)
    return torch.stack((camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy), dim=1)


def _ellipses(
    points: Tensor, quaternions: Tensor, scales: Tensor, camera: Camera, dilation: float
) -> Ellipses:
    """What the linearised projection makes of N Gaussians.

    With M = J W R S the covariance is M M^T + d I. Its determinant ac - b^2 would lose all its digits
    for a long needle; as |u x v|^2 + d (|u|^2 + |v|^2) + d^2, where u and v are the rows of M
    (Cauchy-Binet), nothing cancels and it stays positive.
    """
    axes = rotation_matrices(quaternions) * scales[:, None, :]  # R S: its columns are the axes
    axes = camera.world_to_camera[:3, :3] @ axes
    axes = _projection_jacobians(points, camera) @ axes
    covariances = axes @ axes.transpose(1, 2) + dilation * torch.eye(2, dtype=axes.dtype)
    undilated = (torch.linalg.cross(axes[:, 0], axes[:, 1]) ** 2).sum(1)
    determinants = undilated + dilation * (axes**2).sum((1, 2)) + dilation**2
    return Ellipses(covariances, determinants, undilated)


def _projection_jacobians(points: Tensor, camera: Camera) -> Tensor:
    """Derivative of the pixel position with respect to the camera coordinates, `[N, 2, 3]`.

    Far outside the image the linearisation would stretch a Gaussian without bound. So the
    direction at which it is taken stops a little beyond the image's edge, and has no gradient there.
    """
    x, y, z = points.unbind(1)
    half_width, half_height = camera.width / (2 * camera.fx), camera.height / (2 * camera.fy)
    margin_x, margin_y = FRUSTUM_MARGIN * half_width, FRUSTUM_MARGIN * half_height
    slope_x = (x / z).clamp(
        -camera.cx / camera.fx - margin_x, (camera.width - camera.cx) / camera.fx + margin_x
    )
    slope_y = (y / z).clamp(
        -camera.cy / camera.fy - margin_y, (camera.height - camera.cy) / camera.fy + margin_y
    )
    zero = torch.zeros_like(z)
    rows = (
        torch.stack((camera.fx / z, zero, -camera.fx * slope_x / z), dim=1),
        torch.stack((zero, camera.fy / z, -camera.fy * slope_y / z), dim=1),
    )
    return torch.stack(rows, dim=1)


def rotation_matrices(quaternions: Tensor) -> Tensor:
    """Rotation matrices `[N, 3, 3]` of quaternions `[N, 4]` (w, x, y, z) of any length.

    A zero quaternion is the identity, with zero gradient.
    """
    lengths = quaternions.norm(dim=1, keepdim=True)
    is_zero = lengths == 0
    identity = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=quaternions.dtype)
    unit = torch.where(is_zero, identity, quaternions / torch.where(is_zero, 1.0, lengths))
    w, x, y, z = unit.unbind(1)
    rows = (
        torch.stack((1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)), dim=1),
        torch.stack((2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)), dim=1),
        torch.stack((2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)), dim=1),
    )
    return torch.stack(rows, dim=1)


def _reach(covariances: Tensor, opacities: Tensor) -> Tensor:
    """Half sides `[M, 2]` (pixels) of the box around the ellipse where alpha = ALPHA_MIN.

    opacity * exp(-r^2 / 2) = ALPHA_MIN gives r in standard deviations, up to 3.33 of them.
    """
    standard_deviations = torch.sqrt(2 * torch.log(opacities / ALPHA_MIN))
    sides = torch.stack((covariances[:, 0, 0], covariances[:, 1, 1]), dim=1).sqrt()
    return standard_deviations[:, None] * sides


def _touching(
    centers: Tensor, reach: Tensor, left: int, right: int, top: int, bottom: int
) -> Tensor:
    """Positions, in order of depth, of the ellipses whose box meets the tile."""
    low, high = centers - reach, centers + reach
    meets = (high[:, 0] >= left) & (low[:, 0] <= right)
    meets &= (high[:, 1] >= top) & (low[:, 1] <= bottom)
    return meets.nonzero()[:, 0]


def _composite_tile(
    projected: Projected, chosen: Tensor, left: int, right: int, top: int, bottom: int
) -> Tensor:
    """Colour, depth and alpha, `[height, width, 5]`, of one tile without background."""
    y, x = torch.meshgrid(
        torch.arange(top, bottom, dtype=torch.float64) + 0.5,
        torch.arange(left, right, dtype=torch.float64) + 0.5,
        indexing="ij",
    )
    pixels = torch.stack((x, y), dim=-1).reshape(-1, 1, 2)
    offsets = pixels - projected.centers[chosen]  # [pixels, chosen, 2]
    alphas = _alphas(
        offsets,
        projected.covariances[chosen],
        projected.determinants[chosen],
        projected.opacities[chosen],
    )

    light_after = torch.cumprod(1 - alphas, dim=1)
    light_before = torch.cat((torch.ones_like(light_after[:, :1]), light_after[:, :-1]), dim=1)
    # Light only falls along the ray: once a Gaussian would leave too little, so would all behind it.
    weights = torch.where(light_after > TRANSMITTANCE_MIN, alphas * light_before, 0.0)

    features = torch.cat(
        (
            projected.colors[chosen],
            projected.depths[chosen, None],
            torch.ones_like(projected.depths[chosen, None]),
        ),
        dim=1,
    )
    return (weights @ features).reshape(bottom - top, right - left, 5)


def _alphas(
    offsets: Tensor, covariances: Tensor, determinants: Tensor, opacities: Tensor
) -> Tensor:
    """What share of the light each Gaussian takes at each pixel, `[pixels, chosen]`."""
    a, b, c = covariances[:, 0, 0], covariances[:, 0, 1], covariances[:, 1, 1]
    dx, dy = offsets.unbind(-1)
    squared_distances = (c * dx * dx - 2 * b * dx * dy + a * dy * dy) / determinants
    alphas = opacities * torch.exp(-0.5 * squared_distances)
    alphas = torch.where(alphas >= ALPHA_MIN, alphas, 0.0)
    return alphas.clamp(max=ALPHA_MAX)
