"""The rendering pipeline on a device: project, sort, bin, blend; and back again.

This module knows buffers and kernels. Autograd lives in `model.py` (device-resident Gaussians) and
`functional.py` (plain torch tensors).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from .budget import RECORD, Budget
from .camera import Camera
from .device import Device, DeviceArray
from .errors import ExplainedError
from .finite import undefined_places
from .frames import Block, Frame, Lease, View, make_room
from .tile_lists import BUCKETS, SOURCES, TileLists, chunks_of

PAIRS_AT_FIRST = 1 << 14
"""Room for (tile, Gaussian) pairs before a render has shown how many there are."""

OVERRIDES = frozenset(
    (
        "ALPHA_CUT_INVERSE",
        "EARLY_STOP",
        "EXACT_TILE_TEST",
        "EXP2_DEGREE",
        "RASTER_LANES",
        "TILE_HEIGHT",
        "TILE_WIDTH",
    )
)
"""Macros of the kernels that a `Rasterizer` may be built with instead of their defaults."""


class Rasterizer:
    """Kernels and scratch memory for one device and one number type.

    Args:
        device: where to run; `device.variant` decides which raster kernels and tile size.
        dtype: torch.float32, or torch.float64 where the device supports it.
        memory_budget: bytes that one render and its backward pass may take; None is half of the device's
            memory.
        overrides: values of macros in `OVERRIDES`, for benchmarks and tests that measure what the
            kernels' approximations cost and save.

    Raises:
        ExplainedError: an override that no kernel knows.
    """

    def __init__(
        self,
        device: Device,
        dtype: torch.dtype = torch.float32,
        memory_budget: int | None = None,
        *,
        overrides: Mapping[str, float] | None = None,
    ) -> None:
        overrides = overrides or {}
        if unknown := sorted(set(overrides) - OVERRIDES):
            raise ExplainedError(
                f"no kernel has the setting {', '.join(unknown)}",
                where="Rasterizer: overrides",
                fix=f"use {', '.join(sorted(OVERRIDES))}",
            )
        self.device = device
        self.dtype = dtype
        self.on_cpu = device.variant == "cpu"
        # A CPU with few cores wants large tiles (less overlap), one with many wants enough of them.
        few_cores = self.on_cpu and device.compute_units <= 4
        width, height = ((64, 32) if few_cores else (32, 32)) if self.on_cpu else (16, 16)
        # No number of lanes: as many as the processor has registers for.
        macros = {"TILE_WIDTH": width, "TILE_HEIGHT": height, "RASTER_LANES": 0, **overrides}
        self.tile = (int(macros["TILE_WIDTH"]), int(macros["TILE_HEIGHT"]))
        self.group = 16 if self.on_cpu else 64
        self.budget = Budget(
            memory_budget or device.memory_bytes // 2, dtype, BUCKETS, chunks_of(device)
        )
        self._lists = TileLists(device)
        self.program = device.program(
            "scene",
            "harmonics",
            "projection",
            "cover",
            "project",
            "project_backward",
            *SOURCES,
            dtype=dtype,
            PROJECT_GROUP=self.group,
            **macros,
            **self._lists.macros,
        )
        self.raster_program = device.program(
            "scene",
            "blend",
            "raster_cpu" if self.on_cpu else "raster_gpu",
            dtype=dtype,
            **macros,
            LANES=macros["RASTER_LANES"] if self.on_cpu else 1,
        )
        self._scratch: dict[str, DeviceArray] = {}
        self._frames: list[Frame] = []
        self._pair_capacity = PAIRS_AT_FIRST

    def forward(self, block: Block, view: View) -> tuple[Tensor, Tensor, Tensor, Lease]:
        """Render.

        Returns:
            `rgb [H, W, 3]`, `depth [H, W]`, `alpha [H, W]` as new CPU tensors, and the frame that
            `backward` wants.

        Raises:
            MemoryBudgetError: the image, the Gaussians or the tiles that they cover would not fit.
            CameraError: the image is larger than a device index can address, or the near plane is not
                in front of the camera.
            GaussianError: a background that is not three numbers.
        """
        lease = Lease(self._frames)
        frame = lease.frame
        frame.view = view
        self._prepare(frame, block, view)
        self._project(frame, block, view)
        self._lists.sort(self.program, frame, block.count)
        while True:
            self._lists.bin(self.program, frame, self._capacity_of(frame))
            images = self._blend(frame, view.camera)
            counters = frame.arrays["counters"].read()
            frame.visible, frame.pairs = int(counters[0]), int(counters[1])
            if frame.pairs <= self._capacity_of(frame):
                break
            self._pair_capacity = max(self._pair_capacity, self.budget.grown(frame, block))
            self._fit(frame, "pairs", torch.int32, 2 * self._pair_capacity)
        rgb, depth, alpha = (image.read() for image in images)
        return rgb, depth, alpha, lease

    def backward(
        self,
        frame: Frame,
        block: Block,
        image_gradients: tuple[Tensor | None, Tensor | None, Tensor | None],
        gradients: DeviceArray,
        *,
        accumulate: bool,
        statistics: DeviceArray | None = None,
    ) -> None:
        """Turn gradients of the images into gradients of the parameters.

        Args:
            image_gradients: of `rgb [H, W, 3]`, `depth [H, W]`, `alpha [H, W]`; None is zero.
            gradients: `[rows, capacity]`; the rows of active SH bands are written.
            accumulate: add to what `gradients` holds instead of replacing it.
            statistics: `[2, capacity]`; row 0 gains the NDC norm of each visible Gaussian's
                screen-space mean gradient, row 1 gains one for it.

        Raises:
            ExplainedError: a gradient of an image is not finite.
        """
        arrays, camera = frame.arrays, frame.view.camera
        pixels = camera.width * camera.height
        sums = self._reserve("pair_sums", self.dtype, self._capacity_of(frame) * RECORD)
        d_rgb, d_depth, d_alpha = (
            self._image_gradient(gradient, size, name)
            for gradient, size, name in zip(
                image_gradients,
                (3 * pixels, pixels, pixels),
                ("rgb", "depth", "alpha"),
                strict=True,
            )
        )
        self._run_raster(
            "raster_backward",
            frame,
            arrays["records"],
            arrays["pairs"],
            arrays["tile_starts"],
            arrays["camera"],
            arrays["rgb"],
            arrays["depth"],
            arrays["transmittance"],
            d_rgb,
            d_depth,
            d_alpha,
            sums,
            np.int32(frame.tiles[0]),
            np.int32(image_gradients[1] is not None),
        )
        modified = frame.view.modifiers is not None
        self._run_blocks(
            "project_backward",
            block.capacity,
            block.parameters,
            arrays["modifiers"] if modified else block.parameters,
            arrays["camera"],
            arrays["clamped"],
            sums,
            arrays["slot_start"],
            arrays["slot_count"],
            gradients,
            statistics if statistics is not None else gradients,
            np.uint32(block.count),
            np.uint32(block.capacity),
            np.int32(frame.view.sh_degree),
            np.int32(block.activated),
            np.int32(modified),
            np.int32(accumulate),
            np.int32(statistics is not None),
        )
        self.device.finish()

    def _prepare(self, frame: Frame, block: Block, view: View) -> None:
        """Make room, and send the camera and the opacity factors."""
        camera = view.camera
        view.check()
        width, height = self.tile
        frame.tiles = (-(-camera.width // width), -(-camera.height // height))
        tiles, capacity = frame.tiles[0] * frame.tiles[1], block.capacity
        frame.pair_limit = self.budget.pair_limit(frame, block)
        wide = torch.float64 if self.device.supports_double else self.dtype
        self._fit(frame, "camera", wide, 32)
        self._fit(frame, "records", self.dtype, capacity * RECORD)
        self._fit(frame, "slot_start", torch.int32, capacity)
        self._fit(frame, "slot_count", torch.int32, capacity)
        self._fit(frame, "clamped", torch.uint8, capacity)
        self._fit(frame, "tile_starts", torch.int32, tiles + 1)
        self._fit(frame, "counters", torch.int64, 4)
        self._fit(frame, "transmittance", self.dtype, camera.width * camera.height)
        self._fit(frame, "pairs", torch.int32, 2 * self._pair_capacity)
        self._lists.reserve(capacity, tiles)
        frame.arrays["camera"].write(view.camera_block())
        if view.modifiers is not None:
            self._fit(frame, "modifiers", self.dtype, capacity)
            factors = torch.zeros(capacity, dtype=self.dtype)
            factors[: block.count] = view.modifiers
            frame.arrays["modifiers"].write(factors, 0, capacity)

    def _project(self, frame: Frame, block: Block, view: View) -> None:
        arrays = frame.arrays
        modified = view.modifiers is not None
        self._run_blocks(
            "project",
            block.capacity,
            block.parameters,
            arrays["modifiers"] if modified else block.parameters,
            arrays["camera"],
            arrays["records"],
            self._lists.keys,
            arrays["slot_count"],
            arrays["clamped"],
            self._lists.covers,
            np.uint32(block.count),
            np.uint32(block.capacity),
            np.int32(view.sh_degree),
            np.int32(block.activated),
            np.int32(modified),
        )

    def _blend(self, frame: Frame, camera: Camera) -> tuple[DeviceArray, DeviceArray, DeviceArray]:
        arrays, size = frame.arrays, (camera.height, camera.width)
        rgb, depth, alpha = (self._image(shape) for shape in ((*size, 3), size, size))
        arrays["rgb"], arrays["depth"] = rgb, depth
        self._run_raster(
            "raster",
            frame,
            arrays["records"],
            arrays["pairs"],
            arrays["tile_starts"],
            arrays["counters"],
            arrays["camera"],
            rgb,
            depth,
            alpha,
            arrays["transmittance"],
            np.int32(frame.tiles[0]),
            np.uint32(self._capacity_of(frame)),
        )
        return rgb, depth, alpha

    def _capacity_of(self, frame: Frame) -> int:
        return min(frame.arrays["pairs"].shape[0] // 2, frame.pair_limit)

    def _image(self, shape: tuple[int, ...]) -> DeviceArray:
        if self.device.shares_memory:
            return DeviceArray(
                self.device, shape, self.dtype, over=torch.empty(shape, dtype=self.dtype)
            )
        return DeviceArray(self.device, shape, self.dtype)

    def _image_gradient(self, gradient: Tensor | None, size: int, name: str) -> DeviceArray:
        if gradient is None:
            return self._reserve(f"no_{name}", self.dtype, size)
        gradient = gradient.to(self.dtype).contiguous()
        _refuse_undefined(gradient, name)
        if self.device.shares_memory:
            return DeviceArray(self.device, (size,), self.dtype, over=gradient)
        array = self._reserve(f"d_{name}", self.dtype, size)
        array.write(gradient, 0, size)
        return array

    def _fit(self, frame: Frame, name: str, dtype: torch.dtype, elements: int) -> None:
        make_room(frame.arrays, self.device, name, dtype, elements)

    def _reserve(self, name: str, dtype: torch.dtype, elements: int) -> DeviceArray:
        return make_room(self._scratch, self.device, name, dtype, elements)

    def _run_blocks(self, kernel: str, capacity: int, *arguments: Any) -> None:
        blocks = capacity // self.device.lanes
        size = -(-blocks // self.group) * self.group
        self.program.run(kernel, (size,), (self.group,), *arguments)

    def _run_raster(self, kernel: str, frame: Frame, *arguments: Any) -> None:
        tiles = frame.tiles[0] * frame.tiles[1]
        local = 1 if self.on_cpu else self.tile[0] * self.tile[1]
        self.raster_program.run(kernel, (tiles * local,), (local,), *arguments)


def _refuse_undefined(gradient: Tensor, name: str) -> None:
    """Refuse the gradient of an image that holds a NaN or an infinity."""
    undefined = undefined_places(gradient)
    if len(undefined):
        place = ", ".join(str(index) for index in undefined[0].tolist())
        raise ExplainedError(
            f"the loss has an undefined gradient in {len(undefined)} values of the image {name!r}",
            where=f"backward of a render: {name}[{place}]",
            fix="look for a division by zero or a square root of zero in the loss",
        )
