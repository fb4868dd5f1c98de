"""Reference implementation of the renderer in torch and float64, differentiated by autograd.

It defines the results of the kernels, and the tests compare both. It follows 3D Gaussian Splatting
(Kerbl et al. 2023), with a named constant for every choice.

`render` consists of two calls: `project` turns each Gaussian into an ellipse on the image, a colour and a
depth; `composite` blends the ellipses.
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
"""Gaussians with z at or below this (world units) are culled."""

DILATION = 0.3
"""Added to the variances of every ellipse (square pixels), because a pixel has an area."""

ALPHA_MIN = 1 / 255
"""A Gaussian contributes to the pixels where its alpha is at least this."""

ALPHA_MAX = 0.99
"""Alpha is clamped to this; above it, it has no gradient."""

TRANSMITTANCE_MIN = 1e-4
"""A pixel stops before the Gaussian that would lower its transmittance to this or below."""

FRUSTUM_MARGIN = 0.3
"""Margin around the image, in half image sizes, in which the projection is linearized in place."""

TILE = 16
"""Side of pixel blocks, in pixels; shortens the lists of candidates, without effect on results."""


class Ellipses(NamedTuple):
    """N Gaussians on the image, without their positions."""

    covariances: Tensor
    """`[N, 2, 2]` square pixels, dilation included."""
    determinants: Tensor
    """`[N]` of the covariances."""
    undilated: Tensor
    """`[N]` determinants before dilation; 0 for flat Gaussians seen on edge."""


class Projected(NamedTuple):
    """The M visible Gaussians on the image, nearest first."""

    indices: Tensor
    """`[M]` int64, indices of the Gaussians."""
    centers: Tensor
    """`[M, 2]` pixels. Its gradient is the screen-space gradient for densification."""
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
        quaternions: `[N, 4]` (w, x, y, z) of any length; zero is the identity, without gradient.
        scales: `[N, 3]` standard deviations, world units (not their logarithms).
        opacities: `[N]` in [0, 1] (not logits).
        sh: `[N, K, 3]` spherical-harmonic coefficients, K = 1, 4, 9 or 16.
        camera: the view.
        background: `[3]` colour behind the Gaussians.
        near: Gaussians with z <= near are culled; world units, > 0.
        dilation: added to the variances on the image, square pixels, >= 0.
        compensate_dilation: If True, lower the opacity as dilation widens the ellipse, like the 2D filter
            of Mip-Splatting (Yu et al. 2024, eq. 10).
        smoothing: `[N]` standard deviations >= 0, world units, of a Gaussian filter applied before
            projection: the 3D filter of Mip-Splatting (eq. 9).
        sh_degree: bands to use; a fraction weights the last (`band_weights`). None is all.

    Returns:
        A float64 `Rendering`. Gaussians with a parameter that is not finite are culled.
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
    """Project the visible Gaussians to ellipses, nearest first. Arguments as in `render`."""
    means, quaternions, scales, opacities, sh = (
        t.double() for t in (means, quaternions, scales, opacities, sh)
    )
    if sh_degree is not None:
        sh = sh * band_weights(sh_degree, sh.shape[1])[:, None]
    # The first pass selects the visible Gaussians, and only the second is in autograd. So Gaussians that
    # overflow or lie behind the camera cause no NaN in the gradient.
    with torch.no_grad():
        points, ellipses, strengths = _seen(
            means, quaternions, scales, opacities, camera, dilation, compensate_dilation, smoothing
        )
        finite = _finite(means, quaternions, scales, opacities, sh)
        in_front = (points[:, 2] > near) & (strengths >= ALPHA_MIN)
        has_area = torch.isfinite(ellipses.determinants) & (ellipses.determinants > 0)
        visible = (finite & in_front & has_area).nonzero()[:, 0]
        # Stable: Gaussians of equal depth stay in index order.
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
    """Blend the ellipses front to back over the background."""
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
    """Which Gaussians have only finite parameters, bool `[N]`."""
    return torch.isfinite(torch.cat([t[..., None].flatten(1) for t in parameters], 1)).all(1)


def _smoothed(scales: Tensor, opacities: Tensor, smoothing: Tensor) -> tuple[Tensor, Tensor]:
    """Scales and opacities after convolution with a Gaussian of standard deviation `smoothing`.

    Variances add up, and the opacity falls so that the mass is constant (Mip-Splatting, eq. 9).
    """
    filtered = (smoothing > 0)[:, None]
    # 1 where unfiltered, because the square root has no slope at zero.
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
    """Ellipses of N Gaussians by the linearized projection.

    With M = J W R S the covariance is M M^T + d I. Its determinant ac - b^2 would lose all digits for long
    needles; |u x v|^2 + d (|u|^2 + |v|^2) + d^2, with u and v the rows of M (Cauchy-Binet), does not cancel
    and stays positive.
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

    Far outside the image the linearization would stretch a Gaussian without bound. So its direction is
    clamped a little beyond the image's edge, where it has no gradient.
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

    opacity * exp(-r^2 / 2) = ALPHA_MIN gives r <= 3.33 in standard deviations.
    """
    standard_deviations = torch.sqrt(2 * torch.log(opacities / ALPHA_MIN))
    sides = torch.stack((covariances[:, 0, 0], covariances[:, 1, 1]), dim=1).sqrt()
    return standard_deviations[:, None] * sides


def _touching(
    centers: Tensor, reach: Tensor, left: int, right: int, top: int, bottom: int
) -> Tensor:
    """Positions, in order of depth, of the ellipses whose box intersects the tile."""
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
    # Transmittance only falls along the ray: all Gaussians behind the stop fail the test too.
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
    """Alpha of each Gaussian at each pixel, `[pixels, chosen]`."""
    a, b, c = covariances[:, 0, 0], covariances[:, 0, 1], covariances[:, 1, 1]
    dx, dy = offsets.unbind(-1)
    squared_distances = (c * dx * dx - 2 * b * dx * dy + a * dy * dy) / determinants
    alphas = opacities * torch.exp(-0.5 * squared_distances)
    alphas = torch.where(alphas >= ALPHA_MIN, alphas, 0.0)
    return alphas.clamp(max=ALPHA_MAX)
