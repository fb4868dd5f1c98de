"""Normals of what a camera sees: from rendered depth, and from the smallest axes of the Gaussians.

Both are `[H, W, 3]` in the camera's axes (x right, y down, z forward), point towards the camera, and take
part in autograd.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Camera, GaussianReader, Rendering

LEAST_ALPHA = 0.5
"""Alpha below which the depth of a pixel is unknown."""


def depth_normals(rendering: Rendering, camera: Camera) -> Tensor:
    """Return the normals of a render's depth (depth / alpha), from the neighbours on both sides.

    Returns:
        Unit vectors; 0 on the border of the image, and where the pixel or a neighbour has an alpha below 0.5.
    """
    import torch

    alpha, dtype = rendering.alpha, rendering.depth.dtype
    opaque = alpha.detach() >= LEAST_ALPHA
    z = rendering.depth / alpha.where(opaque, 1.0)
    left, right, above, below = z[1:-1, :-2], z[1:-1, 2:], z[:-2, 1:-1], z[2:, 1:-1]
    u, v = (place[1:-1, 1:-1].to(dtype) for place in camera.pixel_centers())
    # The cross product of the differences of the points z ((u - cx) / fx, (v - cy) / fy, 1), multiplied out.
    wide, high = (left + right) / camera.fx, (above + below) / camera.fy
    x, y = (right - left) * high, (below - above) * wide
    forward = (u - camera.cx) / camera.fx * x + (v - camera.cy) / camera.fy * y + wide * high
    square = x.square() + y.square() + forward.square()
    known = opaque[1:-1, :-2] & opaque[1:-1, 2:] & opaque[:-2, 1:-1] & opaque[2:, 1:-1]
    known = known & opaque[1:-1, 1:-1] & (square.detach() > 0)
    factor = square.where(known, 1.0).rsqrt() * known
    normals = torch.stack([x * factor, y * factor, -forward * factor])
    return torch.nn.functional.pad(normals, (1, 1, 1, 1)).permute(1, 2, 0)


def axis_normals(model: GaussianReader, camera: Camera) -> Tensor:
    """Return the blended normals of the Gaussians (`blended_normals`), at the model's parameters."""
    return blended_normals(
        model.parameter("means"),
        model.parameter("quaternions"),
        model.parameter("scales"),
        model.parameter("opacities"),
        camera,
        dilation=model.dilation,
        compensate_dilation=model.compensate_dilation,
        device=model.device,
    )


def blended(
    model: GaussianReader, values: Tensor, camera: Camera, *, move_gaussians: bool = False
) -> Tensor:
    """Render numbers of each Gaussian: the sum of value * alpha_i * T_i, three channels in one pass.

    Not divided by alpha: 0 where nothing was hit.

    Args:
        values: `[N, C]`, of any size; gradients flow to them.
        move_gaussians: If True, gradients also flow to the parameters of the Gaussians, except their colours.

    Returns:
        `[H, W, C]` in autograd.
    """
    import torch

    from core_rasterizer import rasterize
    from core_rasterizer.gaussians import SH_C0

    names = ("means", "quaternions", "scales", "opacities")
    known = [model.parameter(name) for name in names]
    means, quaternions, scales, opacities = (p if move_gaussians else p.detach() for p in known)
    low, high = values.detach().aminmax(dim=0)
    middle, half = (low + high) / 2, ((high - low) / 2).clamp(min=1e-6)
    # As colours between 1/4 and 3/4, which no clamp changes.
    unit = torch.nn.functional.pad((values - middle) / half, (0, -values.shape[1] % 3))
    images = []
    for three in unit.split(3, dim=1):
        rendering = rasterize(
            means,
            quaternions,
            scales,
            opacities,
            three[:, None] / (4 * SH_C0),
            camera,
            dilation=model.dilation,
            compensate_dilation=model.compensate_dilation,
            device=model.device,
        )
        images.append(4 * rendering.rgb - 2 * rendering.alpha[..., None])
    alpha = rendering.alpha[..., None]
    return torch.cat(images, dim=2)[..., : values.shape[1]] * half + alpha * middle


def blended_normals(
    means: Tensor,
    quaternions: Tensor,
    scales: Tensor,
    opacities: Tensor,
    camera: Camera,
    **options: Any,
) -> Tensor:
    """Render the normal of each Gaussian, its smallest axis: the sum of normal * alpha_i * T_i.

    Not divided by alpha: 0 where nothing was hit.

    Args:
        means, quaternions, scales, opacities, options: as for `core_rasterizer.rasterize`.
    """
    import torch

    from core_rasterizer import rasterize
    from core_rasterizer.gaussians import SH_C0
    from core_rasterizer.reference import rotation_matrices

    pose = camera.world_to_camera.detach().to(means.dtype)
    smallest = scales.detach().argmin(dim=1)
    index = torch.arange(len(means))
    normals = rotation_matrices(quaternions)[index, :, smallest] @ pose[:3, :3].T
    seen = (means.detach() @ pose[:3, :3].T + pose[:3, 3]) * normals.detach()
    normals = normals * (1 - 2 * (seen.sum(dim=1, keepdim=True) > 0).to(normals.dtype))
    # As colours between 1/4 and 3/4, which no clamp changes.
    sh = normals[:, None] / (4 * SH_C0)
    rendering = rasterize(means, quaternions, scales, opacities, sh, camera, **options)
    return 4 * rendering.rgb - 2 * rendering.alpha[..., None]
