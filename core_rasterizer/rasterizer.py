"""The rendering pipeline on a device: project, sort, bin, blend; and back again.

This module knows buffers and kernels. Autograd lives in `model.py` (device-resident Gaussians) and
`rasterize.py` (plain torch tensors).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from .camera import Camera
from .device import Device, DeviceArray
from .errors import CameraError, ExplainedError, GaussianError, MemoryBudgetError

ROWS_BEFORE_SH = 11
"""Parameter rows in front of the SH coefficients: mean 3, scale 3, quaternion 4, opacity 1."""
NEAR_PLANE = 0.2
"""Gaussians nearer than this z-depth are culled (3DGS), world units."""
CAPACITY_STEP = 16
"""Parameter arrays are padded to a multiple of this, the widest vector of any kernel."""
PAIRS_AT_FIRST = 1 << 14
"""Room for (tile, Gaussian) pairs before a render has shown how many there are."""

OVERRIDES = frozenset(
    (
        "ALPHA_CUT_INVERSE",
        "EARLY_STOP",
        "EXACT_TILE_TEST",
        "EXP2_DEGREE",
        "TILE_HEIGHT",
        "TILE_WIDTH",
    )
)
"""Macros of the kernels that a `Rasterizer` may be built with instead of their defaults."""

_LARGEST = 1e37
"""REAL_LARGEST of the kernels: what reaches it is not shown."""
_RECORD = 16
_DIGIT_BITS = 11
_BUCKETS = 1 << _DIGIT_BITS
_PAIR_LIMIT = 3 * 2**30
"""Pairs that 32-bit indices can count, with room for the margin of growing arrays."""


def padded(count: int) -> int:
    """The capacity of parameter arrays that hold `count` Gaussians."""
    return max(CAPACITY_STEP, -(-count // CAPACITY_STEP) * CAPACITY_STEP)


@dataclass(frozen=True)
class Block:
    """Gaussian parameters on a device: `[rows, capacity]`, one row a scalar parameter."""

    parameters: DeviceArray
    count: int
    activated: bool
    """Scales and opacities are stored as such, not as logarithms and logits."""

    @property
    def capacity(self) -> int:
        return self.parameters.shape[1]


@dataclass(frozen=True)
class View:
    """What is to be rendered: camera, background, SH degree, opacity factors."""

    camera: Camera
    background: Sequence[float]
    sh_degree: int
    near: float = NEAR_PLANE
    modifiers: Tensor | None = None
    """`[N]` factors of the activated opacities, or None."""


class Frame:
    """What the backward pass needs of one render; its arrays are reused by later renders."""

    def __init__(self) -> None:
        self.arrays: dict[str, DeviceArray] = {}
        self.view: View
        self.tiles = (0, 0)
        self.pair_limit = 0
        self.visible = 0
        self.pairs = 0


class Lease:
    """Holds a frame and hands it back to the pool when nobody needs the render any more."""

    def __init__(self, pool: list[Frame]) -> None:
        self._pool = pool
        self.frame = pool.pop() if pool else Frame()

    def __del__(self) -> None:
        self._pool.append(self.frame)


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
        self.memory_budget = memory_budget or device.memory_bytes // 2
        self.on_cpu = device.variant == "cpu"
        # A CPU with few cores wants large tiles (less overlap), one with many wants enough of them.
        few_cores = self.on_cpu and device.compute_units <= 4
        width, height = ((64, 32) if few_cores else (32, 32)) if self.on_cpu else (16, 16)
        macros = {"TILE_WIDTH": width, "TILE_HEIGHT": height, **overrides}
        self.tile = (int(macros["TILE_WIDTH"]), int(macros["TILE_HEIGHT"]))
        self.chunks = min(16, 2 * device.compute_units) if self.on_cpu else 64
        self.group = 16 if self.on_cpu else 64
        self.program = device.program(
            "scene",
            "harmonics",
            "projection",
            "cover",
            "project",
            "scan",
            "sort",
            "bin",
            "blend",
            "raster_cpu" if self.on_cpu else "raster_gpu",
            "project_backward",
            dtype=dtype,
            DIGIT_BITS=_DIGIT_BITS,
            PROJECT_GROUP=self.group,
            SCAN_GROUP=self.group,
            **macros,
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
        self._sort(frame, block)
        while True:
            self._bin(frame)
            images = self._blend(frame, view.camera)
            counters = frame.arrays["counters"].read()
            frame.visible, frame.pairs = int(counters[0]), int(counters[1])
            if frame.pairs <= self._capacity_of(frame):
                break
            self._grow_pairs(frame, block)
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
        sums = self._reserve("pair_sums", self.dtype, self._capacity_of(frame) * _RECORD)
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
        if camera.width * camera.height >= 2**28 or max(camera.width, camera.height) > 65535:
            raise CameraError(
                f"an image of {camera.width}x{camera.height} pixels is too large to rasterize",
                where="camera",
                fix="render it in parts, or at a lower resolution",
            )
        _check_view(view)
        width, height = self.tile
        frame.tiles = (-(-camera.width // width), -(-camera.height // height))
        tiles, capacity = frame.tiles[0] * frame.tiles[1], block.capacity
        self._check_budget(frame, block)
        wide = torch.float64 if self.device.supports_double else self.dtype
        self._fit(frame, "camera", wide, 32)
        self._fit(frame, "records", self.dtype, capacity * _RECORD)
        self._fit(frame, "slot_start", torch.int32, capacity)
        self._fit(frame, "slot_count", torch.int32, capacity)
        self._fit(frame, "clamped", torch.uint8, capacity)
        self._fit(frame, "tile_starts", torch.int32, tiles + 1)
        self._fit(frame, "counters", torch.int64, 4)
        self._fit(frame, "transmittance", self.dtype, camera.width * camera.height)
        self._fit(frame, "pairs", torch.int32, 2 * self._pair_capacity)
        for name in ("keys", "keys_a", "order_a", "keys_b", "order_b"):
            self._reserve(name, torch.int32, capacity)
        self._reserve("covers", torch.int32, 4 * capacity)
        self._reserve("counts", torch.int32, self.chunks * max(_BUCKETS, tiles))
        self._reserve("totals", torch.int32, _BUCKETS + 1)
        self._reserve("chunk_pairs", torch.int32, self.chunks + 1)
        frame.arrays["camera"].write(_camera_block(view))
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
            self._scratch["keys"],
            arrays["slot_count"],
            arrays["clamped"],
            self._scratch["covers"],
            np.uint32(block.count),
            np.uint32(block.capacity),
            np.int32(view.sh_degree),
            np.int32(block.activated),
            np.int32(modified),
        )

    def _sort(self, frame: Frame, block: Block) -> None:
        """Leave the visible Gaussians, nearest first, in the scratch array `order_a`."""
        scratch, counters = self._scratch, frame.arrays["counters"]
        counts, totals = scratch["counts"], scratch["totals"]
        passes = (("keys", "keys", "a"), ("keys_a", "order_a", "b"), ("keys_b", "order_b", "a"))
        for number, (keys, order, out) in enumerate(passes):
            settings = (
                np.uint32(block.count),
                np.uint32(number * _DIGIT_BITS),
                np.uint32(number == 0),
            )
            self._run_chunks("count_digits", scratch[keys], counts, counters, *settings)
            self._scan(counts, totals, _BUCKETS, counters, counter=0)
            self._run_chunks(
                "scatter_digits",
                scratch[keys],
                scratch[order],
                scratch[f"keys_{out}"],
                scratch[f"order_{out}"],
                counts,
                totals,
                counters,
                *settings,
            )

    def _bin(self, frame: Frame) -> None:
        arrays, scratch = frame.arrays, self._scratch
        counters, counts, order = arrays["counters"], scratch["counts"], scratch["order_a"]
        tiles = frame.tiles[0] * frame.tiles[1]
        size = (np.uint32(tiles), np.int32(frame.tiles[0]))
        chunk_pairs = scratch["chunk_pairs"]
        self._run_chunks(
            "count_tiles",
            arrays["records"],
            scratch["covers"],
            order,
            counts,
            chunk_pairs,
            counters,
            *size,
            np.uint32(frame.pair_limit),
        )
        self._scan(counts, arrays["tile_starts"], tiles, counters, counter=2)
        self.program.run(
            "scan_buckets", (1,), (1,), chunk_pairs, counters, np.uint32(self.chunks), np.uint32(1)
        )
        self._run_chunks(
            "fill_tiles",
            arrays["records"],
            scratch["covers"],
            order,
            counts,
            arrays["tile_starts"],
            chunk_pairs,
            arrays["pairs"],
            arrays["slot_start"],
            arrays["slot_count"],
            counters,
            *size,
            np.uint32(self._capacity_of(frame)),
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

    def _check_budget(self, frame: Frame, block: Block) -> None:
        """Refuse a render whose image and Gaussians alone are too large; see how many pairs may join."""
        camera, real = frame.view.camera, self.dtype.itemsize
        # Three images, the transmittance, and five numbers a pixel of gradients.
        pixels = camera.width * camera.height * 11 * real
        # Record, cover, sort keys and orders, slots; the tables of counts, a row a chunk.
        gaussians = block.capacity * (_RECORD * real + 16 + 5 * 4 + 2 * 4 + 1)
        counts = 4 * self.chunks * max(_BUCKETS, frame.tiles[0] * frame.tiles[1])
        needed = pixels + gaussians + counts
        if needed > self.memory_budget:
            raise self._over_budget(
                frame, block, f"needs {needed / 2**20:,.0f} MB before its first Gaussian is drawn"
            )
        frame.pair_limit = min(_PAIR_LIMIT, (self.memory_budget - needed) // self._bytes_of_pair)

    def _grow_pairs(self, frame: Frame, block: Block) -> None:
        if frame.pairs > frame.pair_limit:
            needed = frame.pair_limit * self._bytes_of_pair / 2**20
            raise self._over_budget(
                frame,
                block,
                f"has more than {frame.pair_limit:,} (tile, Gaussian) pairs, which need {needed:,.0f} MB "
                "beside the images",
            )
        wanted = min(frame.pairs + frame.pairs // 4, frame.pair_limit)
        self._pair_capacity = max(self._pair_capacity, wanted)
        self._fit(frame, "pairs", torch.int32, 2 * self._pair_capacity)

    @property
    def _bytes_of_pair(self) -> int:
        """A pair takes 8 bytes in the list and a record of sums in the backward pass."""
        return 8 + _RECORD * self.dtype.itemsize

    def _over_budget(self, frame: Frame, block: Block, what: str) -> MemoryBudgetError:
        camera = frame.view.camera
        return MemoryBudgetError(
            f"the render {what}; the budget is {self.memory_budget / 2**20:,.0f} MB",
            where=f"{block.count:,} Gaussians in {camera.width}x{camera.height} pixels",
            fix="lower the number or the size of the Gaussians, render fewer pixels, or raise the memory "
            "budget",
        )

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
        # One pass tells whether all is well; only a sum that is not finite is worth a closer look.
        if not math.isfinite(gradient.sum()):
            _refuse_undefined(gradient, name)
        if self.device.shares_memory:
            return DeviceArray(self.device, (size,), self.dtype, over=gradient)
        array = self._reserve(f"d_{name}", self.dtype, size)
        array.write(gradient, 0, size)
        return array

    def _fit(self, frame: Frame, name: str, dtype: torch.dtype, elements: int) -> None:
        _make_room(frame.arrays, self.device, name, dtype, elements)

    def _reserve(self, name: str, dtype: torch.dtype, elements: int) -> DeviceArray:
        return _make_room(self._scratch, self.device, name, dtype, elements)

    def _scan(
        self,
        counts: DeviceArray,
        totals: DeviceArray,
        buckets: int,
        counters: DeviceArray,
        counter: int,
    ) -> None:
        size = -(-buckets // self.group) * self.group
        self.program.run(
            "scan_chunks",
            (size,),
            (self.group,),
            counts,
            totals,
            np.uint32(buckets),
            np.uint32(self.chunks),
        )
        self.program.run(
            "scan_buckets", (1,), (1,), totals, counters, np.uint32(buckets), np.uint32(counter)
        )

    def _run_blocks(self, kernel: str, capacity: int, *arguments: Any) -> None:
        blocks = capacity // self.device.lanes
        size = -(-blocks // self.group) * self.group
        self.program.run(kernel, (size,), (self.group,), *arguments)

    def _run_chunks(self, kernel: str, *arguments: Any) -> None:
        self.program.run(kernel, (self.chunks,), (1,), *arguments)

    def _run_raster(self, kernel: str, frame: Frame, *arguments: Any) -> None:
        tiles = frame.tiles[0] * frame.tiles[1]
        local = 1 if self.on_cpu else self.tile[0] * self.tile[1]
        self.program.run(kernel, (tiles * local,), (local,), *arguments)


def _make_room(
    arrays: dict[str, DeviceArray], device: Device, name: str, dtype: torch.dtype, elements: int
) -> DeviceArray:
    """An array of at least so many elements; grown with a margin, so that growth is rare."""
    array = arrays.get(name)
    if array is None or array.shape[0] < elements:
        margin = elements // 8 if array is not None else 0
        array = arrays[name] = DeviceArray(device, (elements + margin,), dtype)
    return array


def _check_view(view: View) -> None:
    """Refuse a near plane or a background that would make the image undefined."""
    if not 0 < view.near < _LARGEST:
        raise CameraError(
            f"the near plane is at {view.near}; it must be in front of the camera",
            where="near",
            fix=f"use a small positive depth, such as {NEAR_PLANE}",
        )
    if len(view.background) != 3:
        raise GaussianError(f"{len(view.background)} numbers given, expected 3", field="background")
    for index, value in enumerate(view.background):
        if not abs(value) < _LARGEST:
            raise GaussianError(f"the value is {value}", field="background", index=index)


def _refuse_undefined(gradient: Tensor, name: str) -> None:
    """Refuse the gradient of an image that holds a NaN or an infinity."""
    undefined = (~torch.isfinite(gradient)).nonzero()
    if len(undefined):
        place = ", ".join(str(index) for index in undefined[0].tolist())
        raise ExplainedError(
            f"the loss has an undefined gradient in {len(undefined)} values of the image {name!r}",
            where=f"backward of a render: {name}[{place}]",
            fix="look for a division by zero or a square root of zero in the loss",
        )


def _camera_block(view: View) -> Tensor:
    """The numbers that kernels read of a camera, in the order of `kernels/scene.cl`."""
    camera = view.camera
    pose = camera.world_to_camera
    # Ratios x/z and y/z are clamped a little outside the image, where the linearized projection of a
    # wide Gaussian would explode (3DGS: 1.3 times the half field of view; here off-centre too).
    margin_x, margin_y = 0.15 * camera.width / camera.fx, 0.15 * camera.height / camera.fy
    values = [
        *pose[:3, :3].reshape(-1).tolist(),
        *pose[:3, 3].tolist(),
        *camera.center.tolist(),
        camera.fx,
        camera.fy,
        camera.cx,
        camera.cy,
        -camera.cx / camera.fx - margin_x,
        (camera.width - camera.cx) / camera.fx + margin_x,
        -camera.cy / camera.fy - margin_y,
        (camera.height - camera.cy) / camera.fy + margin_y,
        camera.width,
        camera.height,
        view.near,
        *view.background,
    ]
    return torch.tensor(values + [0.0] * (32 - len(values)), dtype=torch.float64)
