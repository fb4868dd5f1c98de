"""Rendering as a differentiable torch function, for custom training loops."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from .camera import Camera
from .device import Device, DeviceArray, open_device
from .errors import GaussianError
from .gaussians import Gaussians
from .layout import PARAMETERS, padded
from .raster import (
    DILATION,
    NEAR_PLANE,
    Block,
    Coverage,
    Footprint,
    Images,
    Renderer,
    RenderRequest,
    pack,
    unpack_all,
)
from .rendering import Rendering


def rasterize(
    means: Tensor,
    quaternions: Tensor,
    scales: Tensor,
    opacities: Tensor,
    sh: Tensor,
    camera: Camera,
    background: Sequence[float] | Tensor | None = None,
    *,
    near: float = NEAR_PLANE,
    sh_degree: float | None = None,
    dilation: float = DILATION,
    compensate_dilation: bool = False,
    smoothing: Tensor | None = None,
    device: Device | None = None,
) -> Rendering:
    """Render Gaussians; differentiable with respect to the first five arguments and the camera's pose.

    The kernels run in the type of `means`: float32, or float64 where the device supports it. Gaussians
    behind the camera, outside the image, fainter than 1/255 or not finite are invisible and get a zero
    gradient.

    If `camera.world_to_camera` requires a gradient, it gets one, `[4, 4]` with zeros in the last row, which
    treats the twelve entries of [R | t] as independent. To optimize a pose, compute it from six parameters
    and create a new `Camera` at every step.

    Args:
        means: `[N, 3]` centres, world units.
        quaternions: `[N, 4]` rotations (w, x, y, z), normalized internally; zero is the identity.
        scales: `[N, 3]` standard deviations along the Gaussian's axes, world units (not logarithms).
        opacities: `[N]` in [0, 1] (not logits).
        sh: `[N, K, 3]` spherical-harmonic coefficients, K = 1, 4, 9 or 16; colour is max(SH + 0.5, 0).
        camera: the view.
        background: three numbers, the colour behind the scene, without gradient; None is black.
        near: z-depth below which Gaussians are culled, world units, > 0.
        sh_degree: bands to use, 0 to 3; a fraction weights the last band: 1.5 is bands 0 and 1 and half
            of band 2. None, or more than `sh` has, uses all.
        dilation: added to the variances of every ellipse on the image, square pixels, >= 0. Each new
            value builds kernels.
        compensate_dilation: If True, lower the opacity as dilation widens the ellipse, like the 2D filter
            of Mip-Splatting (Yu et al. 2024, eq. 10).
        smoothing: `[N]` standard deviations >= 0, world units, of the 3D filter of Mip-Splatting (eq. 9),
            without gradient: scales become sqrt(s^2 + f^2), and the opacity is multiplied by
            s / sqrt(s^2 + f^2) for each axis.
        device: the OpenCL device; None chooses (`open_device`).

    Returns:
        `rgb [H, W, 3]`, `depth [H, W]` (sum of z alpha T, not divided by alpha) and `alpha [H, W]`.

    Raises:
        GaussianError: inconsistent shapes or types; a background, degree, dilation or smoothing that is
            not finite or out of range.
        CameraError: the image is too large to address, or `near` is not positive.
        MemoryBudgetError: the image or the lists of Gaussians per tile exceed the budget.
    """
    _check(
        {
            "means": means,
            "quaternions": quaternions,
            "scales": scales,
            "opacities": opacities,
            "sh": sh,
        }
    )
    color = (0.0, 0.0, 0.0) if background is None else tuple(float(value) for value in background)
    footprint = Footprint(float(dilation), bool(compensate_dilation))
    renderer = _renderer(device or open_device(), means.dtype, footprint)
    stored = math.isqrt(sh.shape[1]) - 1
    degree = stored if sh_degree is None else min(sh_degree, stored)
    request = RenderRequest(camera, color, degree, near, smoothing=smoothing)
    outputs = _Rasterize.apply(
        means, scales, quaternions, opacities, sh, camera.world_to_camera, renderer, request
    )
    return Rendering.on_device(*outputs)


@cache
def _renderer(device: Device, dtype: torch.dtype, footprint: Footprint) -> Renderer:
    return Renderer(device, dtype, footprint=footprint)


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        means: Tensor,
        scales: Tensor,
        quaternions: Tensor,
        opacities: Tensor,
        sh: Tensor,
        pose: Tensor,
        renderer: Renderer,
        request: RenderRequest,
    ) -> tuple[Tensor, Tensor, Tensor, Tensor, Images, Coverage]:
        gaussians = Gaussians(means, scales, quaternions, opacities, sh)
        count, dtype = len(gaussians), means.dtype
        rows = pack(gaussians, dtype, padded(count))
        parameters = DeviceArray(renderer.device, tuple(rows.shape), dtype)
        parameters.write(rows)
        ctx.block = Block(parameters, count, activated=True)
        images, ctx.lease = renderer.forward(ctx.block, request)
        ctx.set_materialize_grads(False)
        ctx.renderer, ctx.sh_degree, ctx.images = renderer, gaussians.sh_degree, images
        return *images.outputs(), images, ctx.lease.frame.coverage(count)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *image_gradients: Tensor | None) -> tuple[Tensor | None, ...]:
        block, renderer = ctx.block, ctx.renderer
        gradients = DeviceArray(renderer.device, block.parameters.shape, renderer.dtype)
        d_rgb, d_depth, d_alpha, d_loss, *_ = image_gradients
        d_pose = renderer.backward(
            ctx.lease.frame,
            block,
            ctx.images.gradients(d_rgb, d_depth, d_alpha, d_loss),
            gradients,
            accumulate=False,
        )
        by_name = unpack_all(gradients.read(), block.count, ctx.sh_degree)
        return *(by_name[name] for name in PARAMETERS), d_pose, None, None


def _check(tensors: dict[str, Tensor]) -> None:
    """Raise for inconsistent shapes and types, naming the argument."""
    means, sh = tensors["means"], tensors["sh"]
    count = means.shape[0] if means.ndim else 0
    coefficients = sh.shape[1] if sh.ndim == 3 and sh.shape[1] in (1, 4, 9, 16) else 16
    shapes = {
        "means": (count, 3),
        "quaternions": (count, 4),
        "scales": (count, 3),
        "opacities": (count,),
        "sh": (count, coefficients, 3),
    }
    for field, tensor in tensors.items():
        if tuple(tensor.shape) != shapes[field]:
            raise GaussianError(
                f"the shape is {tuple(tensor.shape)}, expected {shapes[field]}", field=field
            )
        if tensor.dtype != means.dtype or tensor.dtype not in (torch.float32, torch.float64):
            raise GaussianError(
                f"the type is {tensor.dtype}; means are {means.dtype}",
                field=field,
                fix="pass all five as float32, or all five as float64",
            )
