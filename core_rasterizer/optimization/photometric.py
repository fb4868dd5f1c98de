"""The photometric loss of 3D Gaussian Splatting, L1 + D-SSIM, fused: value and gradient at once."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ..device import Device, DeviceArray, Scratch, host_pool, open_device
from ..errors import ExplainedError
from ..gaussians import undefined_places
from ..raster import Images, Outputs
from ..rendering import Rendering

SSIM_WEIGHT = 0.2
"""Weight of D-SSIM in the loss of 3DGS."""

_CHANNELS = 3
_RADIUS = 5
"""Of the window, pixels."""
_MAPS = 4
"""Windows of x, x - y, (x - y)^2 and x y."""
_DERIVATIVES = 3
"""Derivatives of SSIM by x, (x - y)^2 and x y."""
_STEP_ROWS = 2
"""Image rows that a step of a CPU's kernel computes."""
_MACROS = {
    "CHANNELS": _CHANNELS,
    "RADIUS": _RADIUS,
    "MAPS": _MAPS,
    "DERIVATIVES": _DERIVATIVES,
    "ROWS": _STEP_ROWS,
}
_BORDER = _RADIUS * _CHANNELS
"""Zeros before and after each row of a filtered map; see the kernel."""
_SCRATCH_ROWS = _STEP_ROWS * _MAPS + (2 * _RADIUS + _STEP_ROWS) * _DERIVATIVES
"""Rows of scratch memory per band: lines and ring; see the kernel."""
_WIDEST_VECTOR = 16
"""Reals of the widest vector that `kernels/lanes.cl` chooses."""
_WORKSPACES = 4
"""Number of image sizes whose scratch memory is cached."""


def photometric_loss(
    rgb: Tensor | Rendering,
    target: Tensor,
    ssim_weight: float = SSIM_WEIGHT,
    *,
    l1_weight: float | None = None,
    device: Device | None = None,
) -> Tensor:
    """Return l1_weight * mean |rgb - target| + ssim_weight * (1 - SSIM).

    SSIM (Wang et al. 2004) as in 3DGS: an 11x11 Gaussian window of sigma 1.5, zeros beyond the border,
    biased moments, C1 = 0.01^2 and C2 = 0.03^2, averaged over all pixels and channels. For equal images
    the loss and its gradient are exactly 0.

    Args:
        rgb: `[H, W, 3]`, float32 or float64 on the CPU; nominally in [0, 1], not clamped. Or a rendering
            by the engine, whose colours and gradient then stay on the device.
        target: `[H, W, 3]`, the photograph, without gradient. A device that does not share memory caches
            a copy until the tensor is freed or modified.
        ssim_weight: in [0, 1]; with `l1_weight` any number >= 0.
        l1_weight: any number >= 0; None is 1 - ssim_weight, as in 3DGS.
        device: where to compute; None is the device of the rendering, else chooses (`open_device`).

    Returns:
        A scalar of the type of `rgb`. The gradient is computed together with the value; second
        derivatives are not supported.

    Raises:
        ExplainedError: invalid shapes, types or weights.
    """
    weights = _weights(l1_weight, ssim_weight)
    if isinstance(rgb, Rendering):
        outputs = _on_device(rgb, target, device)
        if outputs is not None:
            there: Tensor = _LossOnDevice.apply(outputs.losses, outputs.images, target, weights)
            return there
        rgb = rgb.rgb
    if rgb.ndim != 3 or rgb.shape[2] != _CHANNELS or rgb.numel() == 0 or rgb.shape != target.shape:
        raise ExplainedError(
            f"the images have the shapes {tuple(rgb.shape)} and {tuple(target.shape)}",
            where="photometric_loss",
            fix="pass two images of the same shape (height, width, 3)",
        )
    if rgb.dtype not in (torch.float32, torch.float64):
        raise ExplainedError(
            f"the image has the type {rgb.dtype}", where="photometric_loss", fix="use float32"
        )
    loss: Tensor = _PhotometricLoss.apply(rgb, target, weights, device or open_device())
    return loss


def _on_device(rendering: Rendering, target: Tensor, device: Device | None) -> Outputs | None:
    """The rendering's images on the device, if the loss can be computed there."""
    outputs = rendering.device_outputs
    if outputs is None or tuple(target.shape) != (*outputs.images.size, _CHANNELS):
        return None
    fits = device in (None, outputs.images.device) and outputs.images.fits(1)
    return outputs if fits else None


def _weights(l1_weight: float | None, ssim_weight: float) -> tuple[float, float]:
    """Return both weights, checked."""
    if l1_weight is None and ssim_weight > 1:
        raise ExplainedError(
            f"ssim_weight is {ssim_weight}; it must lie in [0, 1]",
            where="photometric_loss",
            fix="pass l1_weight as well if they do not add up to 1",
        )
    l1_weight = 1 - ssim_weight if l1_weight is None else l1_weight
    for name, weight in (("ssim_weight", ssim_weight), ("l1_weight", l1_weight)):
        if not 0 <= weight < math.inf:
            raise ExplainedError(
                f"{name} is {weight}; it must be finite and at least 0", where="photometric_loss"
            )
    return l1_weight, ssim_weight


class _PhotometricLoss(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, rgb: Tensor, target: Tensor, weights: tuple[float, float], device: Device
    ) -> Tensor:
        height, width, _ = rgb.shape
        workspace = _workspace(device, height, width, rgb.dtype)
        loss, gradient = workspace.run_on_host_image(rgb, target, weights, ctx.needs_input_grad[0])
        if not math.isfinite(loss):
            raise _undefined(rgb, target)
        ctx.save_for_backward(gradient)
        return rgb.new_tensor(loss)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, None, None, None]:
        (gradient,) = ctx.saved_tensors
        if float(upstream) != 1.0:  # saves a pass over the image
            gradient = gradient * upstream
        return gradient, None, None, None


class _LossOnDevice(torch.autograd.Function):
    """The gradient stays with the images; `backward` passes on its factor to the render's backward pass."""

    @staticmethod
    def forward(
        ctx: Any, stand_in: Tensor, images: Images, target: Tensor, weights: tuple[float, float]
    ) -> Tensor:
        workspace = _workspace(images.device, *images.size, images.dtype)
        ctx.kept = images.keep("rgb") if ctx.needs_input_grad[0] else None
        gradient = ctx.kept.arrays["rgb"] if ctx.kept else None
        loss = workspace.run(images["rgb"], target, weights, gradient)
        if not math.isfinite(loss):
            raise _undefined(images.read("rgb"), target)
        return stand_in.new_tensor(loss)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, None, None, None]:
        return ctx.kept.passed_on(upstream), None, None, None


class _Bands:
    """The kernel of a CPU: each work-item takes a band of rows."""

    def __init__(self, device: Device, height: int, width: int, dtype: torch.dtype) -> None:
        row = _CHANNELS * width
        # Rows narrower than a vector are processed real by real.
        lanes = device.profile.wide_lanes if row >= _WIDEST_VECTOR else 1
        sources = ("optimization/ssim", "optimization/photometric")
        self._program = device.program(*sources, dtype=dtype, **_MACROS, LANES=lanes)
        band = device.profile.ssim_band(height, device.compute_units)
        self._bands = -(-height // band)
        stride = row + 2 * _BORDER
        self._size = {"height": height, "row": row, "stride": stride, "band_rows": band}
        self._scratch = DeviceArray(device, (self._bands * _SCRATCH_ROWS, stride), dtype)
        self.sums = DeviceArray(device, (height, 2), dtype)

    def run(
        self,
        image: DeviceArray,
        target: DeviceArray,
        gradient: DeviceArray | None,
        scales: Mapping[str, float],
    ) -> None:
        """Write the sums and, if given, the gradient."""
        self._program.run(
            "photometric",
            (self._bands,),
            (1,),
            image=image,
            target=target,
            scratch=self._scratch,
            sums=self.sums,
            result=image if gradient is None else gradient,
            with_gradient=gradient is not None,
            **self._size,
            **scales,
        )


class _Tiles:
    """The kernels of a GPU: each work-group takes a tile of pixels."""

    def __init__(self, device: Device, height: int, width: int, dtype: torch.dtype) -> None:
        tile = device.profile.ssim_tile
        sources = ("optimization/ssim", "optimization/photometric_gpu")
        self._program = device.program(*sources, dtype=dtype, **_MACROS, TILE=tile)
        self._tiles, self._group = -(-height // tile) * -(-width // tile), tile * tile
        self._size = {"width": width, "height": height}
        self.sums = DeviceArray(device, (self._tiles, 2), dtype)
        self._derivatives = Scratch(device)
        self._values = height * width * _CHANNELS * _DERIVATIVES
        self._dtype = dtype

    def run(
        self,
        image: DeviceArray,
        target: DeviceArray,
        gradient: DeviceArray | None,
        scales: Mapping[str, float],
    ) -> None:
        """Write the sums and, if given, the gradient."""
        local, size = (self._group,), (self._tiles * self._group,)
        derivatives = image
        if gradient is not None:
            derivatives = self._derivatives.reserve("derivatives", self._dtype, self._values)
        inputs: dict[str, DeviceArray | float] = {
            "image": image,
            "target": target,
            "derivatives": derivatives,
            **self._size,
        }
        wanted, run = gradient is not None, self._program.run
        run("dissimilarity", size, local, **inputs, sums=self.sums, with_gradient=wanted)
        if gradient is not None:
            run("gradient", size, local, **inputs, result=gradient, **scales)


class _Workspace:
    """Kernels and scratch memory for one image size; a run allocates only its result."""

    def __init__(self, device: Device, height: int, width: int, dtype: torch.dtype) -> None:
        kernels = _Bands if device.variant == "cpu" else _Tiles
        self._kernels = kernels(device, height, width, dtype)
        self._device, self._shape, self._dtype = device, (height, width, _CHANNELS), dtype
        self._on_device = Scratch(device)

    def run_on_host_image(
        self, rgb: Tensor, target: Tensor, weights: tuple[float, float], with_gradient: bool
    ) -> tuple[float, Tensor | None]:
        """`run` for an image on the host; returns the gradient there if `with_gradient`."""
        with self._device.lock:  # threads take turns
            image = self._sent(rgb.detach().to("cpu", self._dtype).contiguous())
            if not with_gradient:
                return self.run(image, target, weights, None), None
            gradient = self._room("gradient")
            loss = self.run(image, target, weights, gradient)
            return loss, gradient.read(0, math.prod(self._shape)).reshape(self._shape)

    def run(
        self,
        image: DeviceArray,
        target: Tensor,
        weights: tuple[float, float],
        gradient: DeviceArray | None,
    ) -> float:
        """Return the loss; write its gradient to `gradient`, if given. Weights are of L1 and D-SSIM."""
        l1_weight, ssim_weight = weights
        values = math.prod(self._shape)
        scales = {"l1_scale": l1_weight / values, "ssim_scale": ssim_weight / values}
        with self._device.lock:
            self._kernels.run(
                image,
                self._device.uploads.of(target, self._dtype),
                gradient,
                scales,
            )
            sums: list[float] = self._kernels.sums.read().sum(dim=0, dtype=torch.float64).tolist()
        return l1_weight * (sums[0] / values) + ssim_weight * (sums[1] / values)

    def _sent(self, values: Tensor) -> DeviceArray:
        if self._device.shares_memory:
            return DeviceArray(self._device, self._shape, self._dtype, over=values)
        array = self._room("image")
        array.write(values, 0, values.numel())
        return array

    def _room(self, name: str) -> DeviceArray:
        """An array for a result: new memory where it becomes a tensor, else scratch."""
        values = math.prod(self._shape)
        if self._device.shares_memory:
            memory = host_pool.empty((values,), self._dtype)
            return DeviceArray(self._device, (values,), self._dtype, over=memory)
        return self._on_device.reserve(name, self._dtype, values)


def _undefined(rgb: Tensor, target: Tensor) -> ExplainedError:
    """The error for a loss that is not finite."""
    for name, image in (("rgb", rgb), ("target", target)):
        bad = undefined_places(image)
        if len(bad):
            y, x, channel = bad[0].tolist()
            return ExplainedError(
                f"{len(bad)} values of the image {name!r} are not finite",
                where=f"photometric_loss: {name}[{y}, {x}, {channel}]",
            )
    return ExplainedError(
        f"the loss overflows: the images reach {max(rgb.abs().max(), target.abs().max()):g}",
        where="photometric_loss",
        fix="pass images with values near [0, 1]",
    )


@lru_cache(maxsize=_WORKSPACES)
def _workspace(device: Device, height: int, width: int, dtype: torch.dtype) -> _Workspace:
    return _Workspace(device, height, width, dtype)
