"""The rendering pipeline on a device: project, sort, bin, blend, and the backward pass.

Autograd is in `optimization/autograd.py` (Gaussians on the device) and `functional.py` (torch tensors).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from weakref import WeakKeyDictionary

import torch
from torch import Tensor

from ..camera import Camera
from ..device import Device, DeviceArray, Scratch
from ..layout import COUNTERS, GAUSSIAN, PAIR, PARAMETER_BITS, row_count
from .block import Block
from .budget import Budget
from .frame import Frame, Lease
from .gpu_tile_lists import GpuTileLists
from .images import CHANNELS, ImageGradient, Images, refuse_undefined
from .pixel_states import PixelStates
from .pose import PoseSums
from .programs import RasterPrograms
from .request import Footprint, RenderRequest
from .tile_lists import CpuTileLists, TileLists

PAIRS_AT_FIRST = 1 << 14
"""Initial capacity of the list of (tile, Gaussian) pairs."""


class Renderer:
    """Kernels and scratch memory for one device and number type; threads take turns.

    Args:
        device: where to run; `device.variant` selects raster kernels and tile size.
        dtype: torch.float32, or torch.float64 where the device supports it.
        memory_budget: bytes for one render and its backward pass; None is half of the device's memory.
        footprint: the filter on the image; None is a dilation of 0.3.
        overrides: values of macros in `programs.OVERRIDES`, for benchmarks and tests of the kernels'
            approximations.

    Raises:
        ExplainedError: an unknown override.
    """

    def __init__(
        self,
        device: Device,
        dtype: torch.dtype = torch.float32,
        memory_budget: int | None = None,
        *,
        footprint: Footprint | None = None,
        overrides: Mapping[str, float] | None = None,
    ) -> None:
        self.device = device
        self.dtype = dtype
        self._lists: TileLists = (
            CpuTileLists(device) if device.variant == "cpu" else GpuTileLists(device)
        )
        self.programs = RasterPrograms(
            device, dtype, self._lists, footprint or Footprint(), overrides or {}
        )
        self._pixel_states = (
            PixelStates(device, dtype, self.programs) if device.variant == "gpu" else None
        )
        self.budget = Budget(
            memory_budget or device.memory_bytes // 2,
            dtype,
            self._lists,
            device.lanes,
            device.buffer_bytes,
            pair=self._pixel_states.bytes_of_pair if self._pixel_states else 0,
            tile=self._pixel_states.bytes_of_tile if self._pixel_states else 0,
        )
        self._wide = torch.float64 if device.supports_double else dtype
        self._poses = PoseSums(device, self._wide)
        self._scratch = Scratch(device)
        self._frames: list[Frame] = []
        self._cameras: WeakKeyDictionary[Camera, tuple[object, DeviceArray]] = WeakKeyDictionary()
        self._pair_capacity = PAIRS_AT_FIRST

    def forward(self, block: Block, request: RenderRequest) -> tuple[Images, Lease]:
        """Render. The device may still be blending when this returns.

        Returns:
            The images on the device, and the frame for `backward`.

        Raises:
            MemoryBudgetError: the image, the Gaussians or the pairs exceed the budget.
            CameraError, GaussianError: see `RenderRequest.check`.
        """
        with self.device.lock:
            lease = Lease(self._frames, self.device)
            frame = lease.frame
            frame.request = request
            self._prepare(frame, block, request)
            self._project(frame, block)
            images = frame.new_images(self.dtype)
            while True:
                self._lists.build(self.programs.base, frame, block.count, self._capacity_of(frame))
                # Blending is enqueued before the number of pairs is known, so that the device does not
                # wait for the host. If they do not fit, it does nothing and runs again.
                counters = frame.arrays["counters"].begin_reading()
                self._blend(frame, images)
                frame.visible, frame.pairs = counters()[:2].tolist()
                if frame.pairs <= self._capacity_of(frame):
                    return images, lease
                self._pair_capacity = max(self._pair_capacity, self.budget.grown(frame, block))
                frame.arrays.reserve("pairs", torch.int32, 2 * self._pair_capacity)

    def backward(
        self,
        frame: Frame,
        block: Block,
        image_gradients: tuple[ImageGradient, ImageGradient, ImageGradient],
        gradients: DeviceArray,
        *,
        accumulate: bool,
        statistics: DeviceArray | None = None,
        detach: Collection[str] = (),
    ) -> Tensor | None:
        """Turn gradients of the images into gradients of the parameters.

        Args:
            image_gradients: of `rgb [H, W, 3]`, `depth [H, W]`, `alpha [H, W]`; None is zero. Those on
                the device must be finite.
            gradients: `[rows, capacity]`; the rows of active SH bands are written.
            accumulate: If True, add to `gradients`, else overwrite.
            statistics: `[2, capacity]` or `[3, capacity]`. For each visible Gaussian, adds the NDC norm
                of its screen-space gradient to row 0, 1 to row 1, and the norm without cancellation
                between pixels to row 2.
            detach: parameters whose gradient stays unchanged.

        Returns:
            The gradient of `camera.world_to_camera`, `[4, 4]` float64; None if it does not require one.

        Raises:
            ExplainedError: a gradient of an image is not finite.
        """
        with self.device.lock:
            wants_pose = frame.request.wants_pose_gradient
            absolute = statistics is not None and statistics.shape[0] == 3
            sums = self.begin_backward(frame, image_gradients, absolute=absolute)
            if sums is None:
                if not accumulate:
                    gradients.fill(0, 0, row_count(frame.request.bands))
                return torch.zeros(4, 4, dtype=torch.float64) if wants_pose else None
            self.project_backward(frame, block, sums, gradients, accumulate, statistics, detach)
            if not wants_pose:
                return None
            program = self.programs.projection(frame.request)
            pose_gradient = self._poses.gradient(program, block, frame.request.camera)
            self.device.queue.flush()
            return pose_gradient

    def begin_backward(
        self,
        frame: Frame,
        image_gradients: tuple[ImageGradient, ImageGradient, ImageGradient],
        *,
        absolute: bool,
    ) -> DeviceArray | None:
        """Run the first part of `backward`, which does not read the parameters.

        Args:
            absolute: If True, also sum the absolute screen gradients.

        Returns:
            Sums of each (tile, Gaussian) pair, valid until the next call. None without pairs.

        Raises:
            ExplainedError: a gradient of an image is not finite.
        """
        camera = frame.request.camera
        with self.device.lock:
            images = {
                f"d_{name}": self._image_gradient(
                    gradient, math.prod((camera.height, camera.width, *rest)), name
                )
                for gradient, (name, rest) in zip(image_gradients, CHANNELS.items(), strict=True)
            }
            if not frame.pairs:
                return None
            with_depth = image_gradients[1] is not None
            sums = self._raster_backward(frame, images, with_depth, absolute)
            # Some drivers start no kernel before a flush or a wait.
            self.device.queue.flush()
            return sums

    def _raster_backward(
        self,
        frame: Frame,
        image_gradients: dict[str, DeviceArray],
        with_depth: bool,
        with_absolute: bool,
    ) -> DeviceArray:
        """Run the blending kernels backward; return the sums of each (tile, Gaussian) pair."""
        arrays = frame.arrays
        sums = self._scratch.reserve("pair_sums", self.dtype, self._capacity_of(frame) * PAIR.size)
        if self._pixel_states:
            self._pixel_states.backward(frame, image_gradients, sums, with_depth, with_absolute)
            return sums
        self.programs.run_on_tiles(
            self.programs.raster(absolute=with_absolute),
            "raster_backward",
            frame.tiles,
            **arrays.named("records", "pairs", "tile_starts", "camera", "rgb", "depth"),
            final_transmittance=arrays["transmittance"],
            **image_gradients,
            pair_sums=sums,
            tiles_x=frame.tiles[0],
            with_depth=with_depth,
        )
        return sums

    def project_backward(
        self,
        frame: Frame,
        block: Block,
        sums: DeviceArray,
        gradients: DeviceArray,
        accumulate: bool,
        statistics: DeviceArray | None,
        detach: Collection[str],
    ) -> None:
        """Run the last part of `backward`, from the result of `begin_backward`."""
        request = frame.request
        self.programs.run_on_blocks(
            self.programs.projection(request),
            "project_backward",
            block.capacity,
            **self._inputs(frame, block),
            **self._backward_inputs(frame, sums, statistics, detach),
            activated=block.activated,
            gradients=gradients,
            accumulate=accumulate,
            pose_sums=self._poses.parts(block) if request.wants_pose_gradient else gradients,
        )
        self.device.queue.flush()

    def project_backward_and_step(
        self,
        frame: Frame,
        block: Block,
        sums: DeviceArray,
        statistics: DeviceArray | None,
        detach: Collection[str],
        /,
        **step: DeviceArray | float,
    ) -> None:
        """Run the last part of `backward` and a step of Adam in one kernel, without storing gradients.

        The render must not require a gradient of its pose.

        Args:
            block: with stored parameters (`activated` False), which the step changes.
            step: moments, rates and the rest of the kernel's arguments; see `Adam`.
        """
        self.programs.run_on_blocks(
            self.programs.step(frame.request),
            "project_backward_and_step",
            block.capacity,
            **self._inputs(frame, block),
            **self._backward_inputs(frame, sums, statistics, detach),
            **step,
        )

    def _inputs(self, frame: Frame, block: Block) -> dict[str, DeviceArray | float]:
        """Arguments that the projection's kernels share, forward and backward."""
        request = frame.request
        return {
            "parameters": block.parameters,
            # If unused, any array.
            "modifiers": frame.arrays["modifiers"] if request.is_modified else block.parameters,
            **frame.arrays.named("camera", "slot_count", "clamped"),
            "count": block.count,
            "capacity": block.capacity,
            "degree": request.bands,
            "modified": request.modifiers is not None,
        }

    def _backward_inputs(
        self,
        frame: Frame,
        sums: DeviceArray,
        statistics: DeviceArray | None,
        detach: Collection[str],
    ) -> dict[str, DeviceArray | float]:
        """Arguments that the backward kernels of the projection share."""
        return {
            "pair_sums": sums,
            "slot_start": frame.arrays["slot_start"],
            "statistics": sums if statistics is None else statistics,
            "collect": 0 if statistics is None else statistics.shape[0] - 1,
            "detached": sum(PARAMETER_BITS[name] for name in detach),
        }

    def _prepare(self, frame: Frame, block: Block, request: RenderRequest) -> None:
        """Allocate arrays, and send the camera, the opacity factors and the smoothing."""
        camera = request.camera
        request.check(block.count)
        width, height = self.programs.tile
        frame.tiles = (-(-camera.width // width), -(-camera.height // height))
        tiles, capacity = frame.tiles[0] * frame.tiles[1], block.capacity
        frame.pair_limit = self.budget.pair_limit(frame, block)
        key = (capacity, camera.width, camera.height, self._pair_capacity)
        if frame.reserved_for != key:
            reserve = frame.arrays.reserve
            reserve("records", self.dtype, capacity * GAUSSIAN.size)
            reserve("slot_start", torch.int32, capacity)
            reserve("slot_count", torch.int32, capacity)
            reserve("clamped", torch.uint8, capacity)
            reserve("tile_starts", torch.int32, tiles + 1)
            reserve("counters", torch.int64, COUNTERS.size)
            reserve("transmittance", self.dtype, camera.width * camera.height)
            reserve("pairs", torch.int32, 2 * self._pair_capacity)
            frame.reserved_for = key
        self._lists.reserve(capacity, tiles)
        frame.arrays["camera"] = self._camera_numbers(request)
        if request.is_modified:
            self._send(frame, "modifiers", request.modifier_rows(capacity, self.dtype).flatten())

    def _camera_numbers(self, request: RenderRequest) -> DeviceArray:
        """The camera block and, on a device without double, its rounding errors; sent once per camera."""
        camera = request.camera
        pose = camera.world_to_camera.tolist()  # somebody may have written into it
        options = (pose, request.near, request.sh_degree, *request.background)
        known = self._cameras.get(camera)
        if known is not None and known[0] == options:
            return known[1]
        exact = request.camera_block()
        values = exact.to(self._wide)
        if not self.device.supports_double:
            values = torch.cat((values, (exact - values).float()))
        # In new memory: kernels of earlier renders may still read the last.
        array = DeviceArray.holding(self.device, values)
        self._cameras[camera] = options, array
        return array

    def _send(self, frame: Frame, name: str, values: Tensor) -> None:
        """Send values in new memory, without waiting for kernels that read the last render's."""
        arrays = frame.arrays
        if self.device.shares_memory:
            shape = tuple(values.shape)
            arrays[name] = DeviceArray(self.device, shape, values.dtype, over=values)
        else:
            arrays.reserve(name, values.dtype, values.numel()).hand_over(values)

    def _project(self, frame: Frame, block: Block) -> None:
        self.programs.run_on_blocks(
            self.programs.projection(frame.request),
            "project",
            block.capacity,
            **self._inputs(frame, block),
            activated=block.activated,
            records=frame.arrays["records"],
            keys=self._lists.keys,
            covers=self._lists.covers,
        )

    def _blend(self, frame: Frame, images: Images) -> None:
        arrays = frame.arrays
        self.programs.run_on_tiles(
            self.programs.raster(),
            "raster",
            frame.tiles,
            **arrays.named("records", "pairs", "tile_starts", "counters", "camera"),
            **{name: images[name] for name in CHANNELS},
            final_transmittance=arrays["transmittance"],
            tiles_x=frame.tiles[0],
            pair_capacity=self._capacity_of(frame),
        )

    def _capacity_of(self, frame: Frame) -> int:
        return min(frame.arrays["pairs"].shape[0] // 2, frame.pair_limit)

    def _image_gradient(self, gradient: ImageGradient, size: int, name: str) -> DeviceArray:
        if isinstance(gradient, DeviceArray):
            return gradient
        if gradient is None:
            return self._scratch.reserve(f"no_{name}", self.dtype, size)
        gradient = gradient.to(self.dtype).contiguous()
        refuse_undefined(gradient, name)
        if self.device.shares_memory:
            return DeviceArray(self.device, (size,), self.dtype, over=gradient)
        array = self._scratch.reserve(f"d_{name}", self.dtype, size)
        array.write(gradient, 0, size)
        return array
