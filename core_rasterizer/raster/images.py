"""Results of a render that stay on the device until they are read, but take part in autograd."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ..device import Device, DeviceArray, Scratch
from ..errors import ExplainedError
from ..gaussians import undefined_places

CHANNELS = {"rgb": (3,), "depth": (), "alpha": ()}
"""Images by name, with the dimensions after height and width."""
ImageGradient = Tensor | DeviceArray | None
_GROUP = 64
_LARGEST = 1e37
"""Larger gradients are read by the host, which refuses what is not finite."""
LOSSES = 64
"""Gradients of losses on the device that a render's images can keep."""


@dataclass
class Kept:
    """Gradients of a loss that was computed on the device.

    Args:
        slot: place of the loss in the placeholder of all losses.
        arrays: gradients of the images by name.
        largest: upper bound of their absolute values, to be set; infinite if it is unknown.
    """

    slot: int
    arrays: dict[str, DeviceArray]
    largest: float = math.inf

    def passed_on(self, upstream: Tensor) -> Tensor:
        """The gradient of the placeholder of all losses, from that of this loss."""
        gradient = torch.zeros(LOSSES, dtype=upstream.dtype)
        gradient[self.slot] = upstream
        return gradient


class Images:
    """Colours, depth and alpha of one render.

    Args:
        device: where they are stored.
        arrays: of the render's frame; reused by later renders.
        size: height and width.
        dtype: of the images.

    Attributes:
        names: of the frame's arrays that the images own while they are referenced.
        fetched: those that tensors share; they may outlive the images.
    """

    def __init__(
        self, device: Device, arrays: Scratch, size: tuple[int, int], dtype: torch.dtype
    ) -> None:
        self.device, self.size, self.dtype = device, size, dtype
        self.names, self.fetched = list[str](), set[str]()
        self._kept: list[Kept] = []
        self._frame_arrays = arrays
        self._arrays = {name: self._room(name, name) for name in CHANNELS}
        self._writes = {name: array.writes_through_torch for name, array in self._arrays.items()}

    def __getitem__(self, name: str) -> DeviceArray:
        return self._arrays[name]

    def read(self, name: str) -> Tensor:
        """Wait for the device; `[H, W, 3]` or `[H, W]` on the CPU."""
        if self.device.shares_memory:
            self.fetched.add(name)
        return self._read(self._arrays[name], name)

    def fits(self, count: int) -> bool:
        """Whether `keep` can be called so many times more."""
        return len(self._kept) + count <= LOSSES

    def keep(self, *names: str) -> Kept:
        """Return arrays for the gradients of a loss on the device, to be written; see `fits`.

        Call this while the render is in autograd; later the frame may be reused.

        Args:
            names: images with gradients.
        """
        slot = len(self._kept)
        arrays = {name: self._room(f"{slot}_{name}", name) for name in names}
        self._kept.append(Kept(slot, arrays))
        return self._kept[-1]

    def outputs(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Placeholders in autograd for the images and losses on the device; their values are never read.

        Returns:
            Three tensors in the images' shapes, which take no memory, and one with a value for each loss.
        """
        shapes = [(*self.size, *rest) for rest in CHANNELS.values()]
        rgb, depth, alpha = (torch.zeros((), dtype=self.dtype).expand(shape) for shape in shapes)
        return rgb, depth, alpha, torch.zeros(LOSSES, dtype=self.dtype)

    def gradients(
        self, rgb: Tensor | None, depth: Tensor | None, alpha: Tensor | None, losses: Tensor | None
    ) -> tuple[ImageGradient, ImageGradient, ImageGradient]:
        """The gradients of the images, from those of `outputs`.

        Gradients of losses on the device stay there unless others are added, or they may overflow.

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
        factors = [0.0] * LOSSES if losses is None else losses.tolist()
        used = [(kept, factors[kept.slot]) for kept in self._kept if factors[kept.slot] != 0]
        return (
            self._total("rgb", rgb, used),
            self._total("depth", depth, used),
            self._total("alpha", alpha, used),
        )

    def _total(
        self, name: str, given: Tensor | None, losses: list[tuple[Kept, float]]
    ) -> ImageGradient:
        """The gradient of an image: `given` plus those of losses on the device times their factors."""
        parts = [(kept, factor) for kept, factor in losses if name in kept.arrays]
        if not parts:
            return given
        if given is None and len(parts) == 1 and parts[0][1] == 1.0:
            return parts[0][0].arrays[name]
        if given is None and sum(abs(f) * kept.largest for kept, f in parts) < _LARGEST:
            return self._sum_on_device(name, parts)
        total = given
        for kept, factor in parts:
            values = self._read(kept.arrays[name], name)
            values = values if factor == 1.0 else values * factor
            total = values if total is None else total + values
        return total

    def _sum_on_device(self, name: str, parts: list[tuple[Kept, float]]) -> DeviceArray:
        total = self._room(f"sum_{name}", name)
        program = self.device.program("raster/add_scaled", dtype=self.dtype)
        count = math.prod(self._shape(name))
        for number, (kept, factor) in enumerate(parts):
            program.run(
                "add_scaled",
                (-(-count // _GROUP) * _GROUP,),
                (_GROUP,),
                values=kept.arrays[name],
                total=total,
                factor=factor,
                add=number > 0,
                count=count,
            )
        return total

    def _shape(self, name: str) -> tuple[int, ...]:
        return (*self.size, *CHANNELS[name])

    def _read(self, array: DeviceArray, name: str) -> Tensor:
        shape = self._shape(name)
        return array.read(0, math.prod(shape)).reshape(shape)

    def _room(self, name: str, image: str) -> DeviceArray:
        """An array in the shape of an image, as the frame's array `name`."""
        self.names.append(name)
        return self._frame_arrays.for_results(name, self.dtype, math.prod(self._shape(image)))


def refuse_undefined(gradient: Tensor, name: str) -> None:
    """Raise if an image's gradient is not finite.

    Raises:
        ExplainedError: names the first pixel.
    """
    undefined = undefined_places(gradient)
    if len(undefined):
        place = ", ".join(str(index) for index in undefined[0].tolist())
        raise ExplainedError(
            f"the loss has an undefined gradient in {len(undefined)} values of the image {name!r}",
            where=f"backward of a render: {name}[{place}]",
            fix="look for a division by zero or a square root of zero in the loss",
        )


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
        *stand_ins, self.losses = tensors
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
