"""The images of a render: on the device until somebody asks for one, and in autograd all the same."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ..device import Device, DeviceArray, Scratch
from ..errors import ExplainedError

CHANNELS = {"rgb": (3,), "depth": (), "alpha": ()}
"""The images by name, and what follows height and width in their shapes."""
KEPT = (*CHANNELS, "loss_gradient")
"""Arrays of a frame that belong to whoever still holds the images."""


class Images:
    """Colours, depth and alpha of one render.

    Args:
        device: where they are.
        arrays: of the frame that the render leases; where memory is not shared they are used again.
        size: height and width.
        dtype: of the images.

    Attributes:
        loss_gradient: the gradient of a loss that was computed on the device, `[H, W, 3]`.
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
        """Where a loss on the device may leave the gradient of the colours.

        To be asked for once, while the render is in autograd: later the frame is somebody else's.
        """
        self.loss_gradient = self._room("loss_gradient", (*self.size, 3))
        return self.loss_gradient

    def outputs(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """What stands for the images and for a loss on the device in autograd; no value is ever read.

        Returns:
            Three tensors in the shapes of the images, that take no memory, and a scalar.
        """
        shapes = [(*self.size, *rest) for rest in CHANNELS.values()]
        rgb, depth, alpha = (torch.zeros((), dtype=self.dtype).expand(shape) for shape in shapes)
        return rgb, depth, alpha, torch.zeros((), dtype=self.dtype)

    def gradients(
        self, rgb: Tensor | None, depth: Tensor | None, alpha: Tensor | None, loss: Tensor | None
    ) -> tuple[Tensor | DeviceArray | None, Tensor | None, Tensor | None]:
        """The gradients of the images, from those of `outputs`.

        The gradient of a loss on the device stays there unless there is something to add to it, or to
        multiply it with.

        Raises:
            ExplainedError: an image that the backward pass reads was written to.
        """
        for name in ("rgb", "depth"):
            if self._arrays[name].writes_through_torch != self._writes[name]:
                raise ExplainedError(
                    f"the image {name!r} of a render was written to before its backward pass",
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
        # What is handed out as a tensor may live on, so it cannot be used again.
        memory = torch.empty(shape, dtype=self.dtype)
        arrays[name] = DeviceArray(self.device, (memory.numel(),), self.dtype, over=memory)
        return arrays[name]


class Outputs:
    """One render's images in autograd.

    Args:
        images: on the device.
        tensors: what autograd made of `Images.outputs`.
    """

    def __init__(self, images: Images, tensors: tuple[Tensor, Tensor, Tensor, Tensor]) -> None:
        self.images = images
        *stand_ins, self.loss = tensors
        self._stand_ins = dict(zip(CHANNELS, stand_ins, strict=True))

    def fetch(self, name: str) -> Tensor:
        """An image as a tensor on the CPU."""
        stand_in = self._stand_ins[name]
        # Whoever is the first to ask, perhaps just to look, decides nothing for those who follow.
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
