"""A loss term in one kernel, which computes its gradients as well; renders stay on the device."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ..device import Device, DeviceArray, Scratch, open_device
from ..errors import ExplainedError
from ..raster import CHANNELS, Kept, Outputs, refuse_undefined
from ..rendering import Rendering
from .pixel_source import GROUP, pixel_kernel

Input = Rendering | Tensor | float | None
"""Of a term; numbers of type int stay integers."""


class PixelTerm:
    """A loss over the pixels of images, and its gradients, in one OpenCL kernel.

    The source is statements of OpenCL C 1.2 for the pixel in column `x` and row `y`. They read

    - `width`, `height`, and `p`, which is y * width + x;
    - each input by its name: images and masks as arrays, such as `depth[p]` and `rgb[3 * p + channel]`, of
      this and other pixels, and numbers. A rendering given as `view` is `view_rgb`, `view_depth` and
      `view_alpha`. In `#if`, `HAS_name` is 0 for an input that is None, else 1.

    They add the pixel's share to `loss`, and add to `d_name[...]`, the gradient by the input `name`, which
    has its layout and begins at 0. `real` is the type of numbers; `continue` ends a pixel. Pixels run in
    parallel, so each may write only the gradient of its own values. If the share of a neighbour depends on
    them too, compute that part here.

    Sums have a fixed order: equal inputs give equal bits on a device.

    Args:
        source: the statements. They must stay within the images.
        gradients: names of the images with a gradient; all others are constants.
        helpers: macros and functions that the source uses.
        in_rows: run the pixels of a row in order, from left to right; each may add to gradients in its whole
            row. A row is one work-item, which is slower on a GPU.
        name: in errors.
    """

    def __init__(
        self,
        source: str,
        gradients: Collection[str],
        *,
        helpers: str = "",
        in_rows: bool = False,
        name: str = "term",
    ) -> None:
        self._texts, self._name = (source, helpers, name), name
        self.gradients, self._in_rows = tuple(gradients), in_rows
        self._words = frozenset((*re.findall(r"\w+", source + helpers), *gradients))
        self._scratch: dict[Device, Scratch] = {}

    def __call__(self, *, device: Device | None = None, **given: Input) -> Tensor:
        """Return the sum of all pixels' shares: a scalar in autograd.

        Args:
            device: where to compute if no rendering is the engine's; None chooses (`open_device`).
            given: the inputs by name: renderings, images `[H, W]` or `[H, W, C]`, masks `[H, W]` bool,
                numbers, or None.

        Raises:
            ExplainedError: an input that the source does not name, or of another type or size; a gradient of
                an image that is not given.
            DeviceError: the compiler rejects the source.
        """
        for name in given:
            if not self._words & {name, f"HAS_{name}", *(f"{name}_{image}" for image in CHANNELS)}:
                what = f"the source does not name the input {name!r}"
                raise self._refused(what, "correct the name, or leave the input out")
        inputs = self._inputs(given, device)
        leaves = dict[str, Tensor]()
        for name in self.gradients:
            source = inputs.sources[name]
            leaves[name] = source if isinstance(source, Tensor) else source.outputs.losses
        loss: Tensor = _Evaluate.apply(self, inputs, *leaves.values())
        return loss

    def run(self, inputs: _Inputs, gradients: Mapping[str, DeviceArray]) -> tuple[float, float]:
        """Write the gradients; return the loss, and the largest absolute gradient."""
        device, (height, width) = inputs.device, inputs.size
        rows = self._in_rows or device.variant == "cpu"
        groups, local = (height, 1) if rows else (-(-height * width // GROUP), GROUP)
        channels = tuple((name, inputs.channels(name)) for name in self.gradients)
        text = pixel_kernel(*self._texts, inputs.kinds, inputs.given, channels, rows)
        program = device.program(text, dtype=inputs.dtype)
        with device.lock:
            scratch = self._scratch.setdefault(device, Scratch(device))
            sums = scratch.reserve(f"sums of {inputs.dtype}", inputs.dtype, 2 * groups)
            program.run(
                "pixel_term",
                (groups * local,),
                (local,),
                **inputs.values,
                **{f"d_{name}": array for name, array in gradients.items()},
                sums=sums,
                width=width,
                height=height,
            )
            pairs = sums.read(0, 2 * groups).reshape(groups, 2)
            return float(pairs[:, 0].double().sum()), float(pairs[:, 1].max())

    def _inputs(self, given: Mapping[str, Input], device: Device | None) -> _Inputs:
        """Check the inputs, and send those that are not on the device."""
        outputs = [r.device_outputs for r in given.values() if isinstance(r, Rendering)]
        there = [one.images.device for one in outputs if one is not None]
        device = there[0] if there else device or open_device()
        sources, numbers = dict[str, Tensor | _OnDevice](), dict[str, float]()
        for name, value in given.items():
            if isinstance(value, Rendering):
                sources |= self._images_of(name, value, device)
            elif isinstance(value, Tensor):
                sources[name] = value
            elif isinstance(value, int | float):
                numbers[name] = value
            elif value is not None:
                what = f"the input {name!r} is a {type(value).__name__}"
                raise self._refused(what, "pass a Rendering, a torch.Tensor, a number or None")
        for name in self.gradients:
            if name not in sources:
                what = f"no image {name!r} is given, of which it has a gradient"
                raise self._refused(what, "pass it, or take it out of `gradients`")
        if not sources:
            raise self._refused("no image is given", "pass at least one, which has the size")
        size, dtype = self._size_and_type(sources)
        values, kinds = dict[str, DeviceArray | float](numbers), list[tuple[str, str]]()
        for name, source in sources.items():
            if isinstance(source, Tensor):
                mask = source.dtype == torch.bool
                values[name] = device.uploads.of(source, torch.uint8 if mask else dtype)
                kinds.append((name, "mask" if mask else "image"))
            else:
                values[name] = source.outputs.images[source.image]
                kinds.append((name, "image"))
        kinds += [(name, "int" if isinstance(n, int) else "real") for name, n in numbers.items()]
        known = tuple((name, value is not None) for name, value in given.items())
        return _Inputs(device, dtype, size, sources, values, tuple(kinds), known)

    def _images_of(
        self, name: str, rendering: Rendering, device: Device
    ) -> dict[str, Tensor | _OnDevice]:
        """The images of a rendering that the source names."""
        outputs = rendering.device_outputs
        if outputs and not (
            outputs.images.device is device and outputs.images.fits(len(self.gradients))
        ):
            outputs = None
        found = dict[str, Tensor | _OnDevice]()
        for image in CHANNELS:
            if (title := f"{name}_{image}") in self._words:
                found[title] = _OnDevice(outputs, image) if outputs else getattr(rendering, image)
        return found

    def _size_and_type(
        self, sources: Mapping[str, Tensor | _OnDevice]
    ) -> tuple[tuple[int, int], torch.dtype]:
        """Height and width of all images, and the type of the first image that is not a mask.

        Raises:
            ExplainedError: the sizes differ, or a type is not floating point or bool.
        """
        size: tuple[int, int] | None = None
        dtype: torch.dtype | None = None
        for name, source in sources.items():
            shape = tuple(source.shape)
            mask = source.dtype == torch.bool
            if not (mask and len(shape) == 2) and not (
                source.dtype.is_floating_point and len(shape) in (2, 3)
            ):
                raise self._refused(
                    f"the input {name!r} is {source.dtype} {shape}",
                    "pass images [H, W] or [H, W, C] of float32, or masks [H, W] of bool",
                )
            size = size or (shape[0], shape[1])
            if shape[:2] != size:
                what = f"the input {name!r} has the size {shape[:2]}, others {size}"
                raise self._refused(
                    what, "resize it, for example with registry.toolkit.images.at_size"
                )
            dtype = dtype or (None if mask else source.dtype)
        assert size is not None
        return size, dtype or torch.float32

    def _refused(self, what: str, fix: str) -> ExplainedError:
        return ExplainedError(what, where=f"call of the PixelTerm {self._name!r}", fix=fix)


class _OnDevice(NamedTuple):
    """An image of a render by the engine."""

    outputs: Outputs
    image: str

    @property
    def shape(self) -> tuple[int, ...]:
        return (*self.outputs.images.size, *CHANNELS[self.image])

    @property
    def dtype(self) -> torch.dtype:
        return self.outputs.images.dtype


class _Inputs(NamedTuple):
    """Checked inputs of a call: the images, the kernel's arguments, and what its source depends on."""

    device: Device
    dtype: torch.dtype
    size: tuple[int, int]
    sources: Mapping[str, Tensor | _OnDevice]
    values: Mapping[str, DeviceArray | float]
    kinds: tuple[tuple[str, str], ...]
    given: tuple[tuple[str, bool], ...]

    def channels(self, name: str) -> int:
        """Numbers per pixel of an image."""
        return math.prod(self.sources[name].shape[2:])

    def room(self, name: str) -> DeviceArray:
        """A new array for the gradient of an image."""
        return DeviceArray.for_results(self.device, math.prod(self.sources[name].shape), self.dtype)


class _Evaluate(torch.autograd.Function):
    """The gradients are computed together with the value; those of renders stay with their images."""

    @staticmethod
    def forward(ctx: Any, term: PixelTerm, inputs: _Inputs, *leaves: Tensor) -> Tensor:
        ctx.inputs, ctx.arrays, ctx.kept = inputs, dict[str, DeviceArray](), dict[str, Kept]()
        for name, needed in zip(term.gradients, ctx.needs_input_grad[2:], strict=True):
            source = inputs.sources[name]
            if needed and not isinstance(source, Tensor):
                ctx.kept[name] = source.outputs.images.keep(source.image)
                ctx.arrays[name] = ctx.kept[name].arrays[source.image]
            else:
                ctx.arrays[name] = inputs.room(name)
        loss, ctx.largest = term.run(inputs, ctx.arrays)
        for kept in ctx.kept.values():
            kept.largest = ctx.largest
        return torch.tensor(loss, dtype=inputs.dtype)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor | None, ...]:
        gradients = list[Tensor | None]()
        for (name, array), needed in zip(ctx.arrays.items(), ctx.needs_input_grad[2:], strict=True):
            source = ctx.inputs.sources[name]
            if not math.isfinite(ctx.largest) or (needed and isinstance(source, Tensor)):
                values = array.read(0, math.prod(source.shape)).reshape(source.shape)
            if not math.isfinite(ctx.largest):
                refuse_undefined(values, name)
            if not needed:
                gradients.append(None)
            elif isinstance(source, Tensor):
                gradients.append((values * upstream).to(source.dtype))
            else:
                gradients.append(ctx.kept[name].passed_on(upstream))
        return None, None, *gradients
