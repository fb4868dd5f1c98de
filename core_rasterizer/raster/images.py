"""Results of a render that stay on the device until they are read, but take part in autograd."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ..device import Device, DeviceArray, Scratch, host_pool
from ..errors import ExplainedError

CHANNELS = {"rgb": (3,), "depth": (), "alpha": ()}
"""Images by name, with the dimensions after height and width."""
KEPT = (*CHANNELS, "loss_gradient")
"""Arrays of a frame that the images own while they are referenced."""


class Images:
    """Colours, depth and alpha of one render.

    Args:
        device: where they are stored.
        arrays: of the render's frame; reused by later renders where memory is not shared.
        size: height and width.
        dtype: of the images.

    Attributes:
        loss_gradient: `[H, W, 3]`, gradient of a loss computed on the device.
    """

    def __init__(
        self, device: Device, arrays: Scratch, size: tuple[int, int], dtype: torch.dtype
    ) -> None:
        self.device, self.size, self.dtype = device, size, dtype
        self._frame_arrays = arrays
        self._arrays = {name: self._room(name, (*size, *rest)) for name, rest in CHANNELS.items()}
        self._writes = {name: array.writes_through_torch for name, array in self._arrays.items()}
        self.loss_gradient: DeviceArray | None = None

    def __getitem__(self, name: str) -> DeviceArray:
        return self._arrays[name]

    def read(self, name: str) -> Tensor:
        """Wait for the device; `[H, W, 3]` or `[H, W]` on the CPU."""
        return self._read(self._arrays[name], CHANNELS[name])

    def room_for_loss_gradient(self) -> DeviceArray:
        """Return an array for the colour gradient of a loss computed on the device.

        Call this at most once, while the render is in autograd; later the frame may be reused.
        """
        self.loss_gradient = self._room("loss_gradient", (*self.size, 3))
        return self.loss_gradient

    def outputs(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Placeholders in autograd for the images and a loss on the device; their values are never read.

        Returns:
            Three tensors in the images' shapes, which take no memory, and a scalar.
        """
        shapes = [(*self.size, *rest) for rest in CHANNELS.values()]
        rgb, depth, alpha = (torch.zeros((), dtype=self.dtype).expand(shape) for shape in shapes)
        return rgb, depth, alpha, torch.zeros((), dtype=self.dtype)

    def gradients(
        self, rgb: Tensor | None, depth: Tensor | None, alpha: Tensor | None, loss: Tensor | None
    ) -> tuple[Tensor | DeviceArray | None, Tensor | None, Tensor | None]:
        """The gradients of the images, from those of `outputs`.

        The gradient of a loss on the device stays there unless it must be scaled or added to.

        Raises:
            ExplainedError: an image that the backward pass reads was modified.
        """
        for name in ("rgb", "depth"):
            if self._arrays[name].writes_through_torch != self._writes[name]:
                raise ExplainedError(
                    f"the image {name!r} of a render was modified before its backward pass",
                    where=f"backward of a render: {name}",
                    fix="work on a copy (`tensor.clone()`)",
                )
        if loss is None or self.loss_gradient is None:
            return rgb, depth, alpha
        if rgb is None and float(loss) == 1.0:
            return self.loss_gradient, depth, alpha
        colors = self._read(self.loss_gradient, CHANNELS["rgb"])
        if float(loss) != 1.0:
            colors = colors * loss
        return colors if rgb is None else rgb + colors, depth, alpha

    def _read(self, array: DeviceArray, rest: tuple[int, ...]) -> Tensor:
        shape = (*self.size, *rest)
        return array.read(0, math.prod(shape)).reshape(shape)

    def _room(self, name: str, shape: tuple[int, ...]) -> DeviceArray:
        arrays = self._frame_arrays
        if not self.device.shares_memory:
            return arrays.reserve(name, self.dtype, math.prod(shape))
        # Tensors that share this memory may outlive the frame, so it cannot be reused.
        memory = host_pool.empty(shape, self.dtype)
        arrays[name] = DeviceArray(self.device, (memory.numel(),), self.dtype, over=memory)
        return arrays[name]


class Coverage:
    """Number of tiles that each Gaussian of a render covers; read only on demand.

    Args:
        tiles_covered: `[capacity]` int32, or longer; not written to while this object exists.
        count: number of Gaussians, N.
    """

    def __init__(self, tiles_covered: DeviceArray, count: int) -> None:
        self._tiles_covered, self._count = tiles_covered, count

    def visible(self) -> Tensor:
        """Which Gaussians cover a tile, bool `[N]`."""
        return self._tiles_covered.read(0, self._count) > 0


class Outputs:
    """One render's images in autograd.

    Args:
        images: on the device.
        tensors: `Images.outputs` as returned by the autograd function.
    """

    def __init__(self, images: Images, tensors: tuple[Tensor, Tensor, Tensor, Tensor]) -> None:
        self.images = images
        *stand_ins, self.loss = tensors
        self._stand_ins = dict(zip(CHANNELS, stand_ins, strict=True))

    def fetch(self, name: str) -> Tensor:
        """An image as a tensor on the CPU."""
        stand_in = self._stand_ins[name]
        # The first read may happen under `no_grad`; later ones must not depend on it.
        with torch.set_grad_enabled(stand_in.requires_grad):
            image: Tensor = _Fetch.apply(stand_in, self.images, name)
        return image


class _Fetch(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, stand_in: Tensor, images: Images, name: str) -> Tensor:
        return images.read(name)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None, None]:
        return gradient, None, None
