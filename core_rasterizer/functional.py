"""Rendering as an ordinary differentiable torch function, for people with a loop of their own."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from .camera import Camera
from .device import Device, DeviceArray, open_device
from .errors import GaussianError
from .frames import NEAR_PLANE, Block, View, padded
from .gaussians import Gaussians
from .model import rows_from
from .rasterizer import Rasterizer
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
    device: Device | None = None,
) -> Rendering:
    """Render Gaussians; differentiable with respect to the first five arguments.

    The kernels run in the type of `means`: float32, or float64 on devices that have it. Gaussians
    that are behind the camera, outside the image, fainter than 1/255 or not finite are invisible and
    get a zero gradient.

    Args:
        means: `[N, 3]` centres, world units.
        quaternions: `[N, 4]` rotations (w, x, y, z), any length; normalized inside, zero = identity.
        scales: `[N, 3]` standard deviations along the Gaussian's axes, world units (not logarithms).
        opacities: `[N]` in [0, 1] (not logits).
        sh: `[N, K, 3]` spherical-harmonic coefficients, K = 1, 4, 9 or 16; colour is SH + 0.5, clamped
            at 0 below.
        camera: what to look through.
        background: three numbers, the colour behind the scene; None is black. No gradient flows to it.
        near: z-depth below which Gaussians are culled, world units, > 0.
        device: the OpenCL device; None chooses (`open_device`).

    Returns:
        `rgb [H, W, 3]`, `depth [H, W]` (sum of z alpha T, not divided by alpha) and `alpha [H, W]`.

    Raises:
        GaussianError: shapes or types that do not fit together, a background that is not finite.
        CameraError: the image is too large to address, or `near` is not positive.
        MemoryBudgetError: the image or the tiles that the Gaussians cover would not fit.
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
    rasterizer = _rasterizer(device or open_device(), means.dtype)
    outputs = _Rasterize.apply(
        means, scales, quaternions, opacities, sh, rasterizer, camera, color, near
    )
    return Rendering(*outputs)


@cache
def _rasterizer(device: Device, dtype: torch.dtype) -> Rasterizer:
    return Rasterizer(device, dtype)


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        means: Tensor,
        scales: Tensor,
        quaternions: Tensor,
        opacities: Tensor,
        sh: Tensor,
        rasterizer: Rasterizer,
        camera: Camera,
        background: tuple[float, ...],
        near: float,
    ) -> tuple[Tensor, Tensor, Tensor]:
        gaussians = Gaussians(means, scales, quaternions, opacities, sh)
        count, dtype = len(gaussians), means.dtype
        rows = rows_from(gaussians, dtype, padded(count))
        parameters = DeviceArray(rasterizer.device, tuple(rows.shape), dtype)
        parameters.write(rows)
        ctx.block = Block(parameters, count, activated=True)
        view = View(camera, background, gaussians.sh_degree, near)
        rgb, depth, alpha, ctx.lease = rasterizer.forward(ctx.block, view)
        ctx.set_materialize_grads(False)
        ctx.rasterizer, ctx.sh_shape = rasterizer, sh.shape
        ctx.save_for_backward(rgb, depth)  # so that torch notices changes in place
        return rgb, depth, alpha

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *image_gradients: Tensor | None) -> tuple[Tensor | None, ...]:
        _ = ctx.saved_tensors
        block, rasterizer = ctx.block, ctx.rasterizer
        gradients = DeviceArray(rasterizer.device, block.parameters.shape, rasterizer.dtype)
        d_rgb, d_depth, d_alpha = image_gradients
        rasterizer.backward(
            ctx.lease.frame, block, (d_rgb, d_depth, d_alpha), gradients, accumulate=False
        )
        rows = gradients.read()[:, : block.count].T
        return (
            rows[:, 0:3].contiguous(),
            rows[:, 3:6].contiguous(),
            rows[:, 6:10].contiguous(),
            rows[:, 10].contiguous(),
            rows[:, 11:].reshape(ctx.sh_shape),
            *(None,) * 4,
        )


def _check(tensors: dict[str, Tensor]) -> None:
    """Refuse shapes and types that do not fit together, naming the argument."""
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
                fix="give all five as float32, or all five as float64",
            )
