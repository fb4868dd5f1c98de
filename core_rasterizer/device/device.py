"""One OpenCL device: its context and queue, its memory, and the kernels that were built for it."""

from __future__ import annotations

import os
from threading import RLock
from typing import Any, Literal

import pyopencl as cl
import torch
from torch import Tensor

from ..errors import DeviceError, MemoryBudgetError
from .program import Program
from .retired import Retired
from .unknown_cpu import better_cpu_name, correct_cpu_name, told_cpu_name
from .uploads import Uploads

CORRECT_CPU_NAME = "STEREOGS_CORRECT_CPU_NAME"
"""Environment variable: 1 tells the driver which processor it has before anything fails (`unknown_cpu`)."""

Kind = Literal["cpu", "gpu", "accelerator"]
Variant = Literal["cpu", "gpu"]

CPU_LANES = 8
"""Vector width of kernels on a CPU: eight floats fill an AVX register. Wider brought nothing, but to the
rasterizer, which chooses for itself (`kernels/lanes.cl`)."""


class Device:
    """One OpenCL device with a queue of its own, opened when it is first used.

    Threads may share it: who uses memory that others use too holds `lock` meanwhile.

    Attributes:
        name, platform: as the driver reports them.
        kind: "cpu", "gpu" or "accelerator".
        variant: which raster kernels run: "cpu" (a work-item a tile, vectors along rows) or "gpu"
            (a work-item a pixel, a work-group a tile). Chosen by kind unless given.
        shares_memory: device buffers are host memory, so that torch sees them without a copy.
        bytes_moved: bytes copied between host and a device that does not share memory.
        lock: held while a kernel is enqueued, and by the owner of scratch memory while work on it lasts.
        retired: memory that nobody holds any more, but that kernels under way may still use.
        uploads: copies of what does not change on the host.
    """

    def __init__(
        self,
        handle: cl.Device,
        variant: Variant | None = None,
        shares_memory: bool | None = None,
    ) -> None:
        self._handle = handle
        self.name = handle.name.strip()
        self.platform = handle.platform.name.strip()
        self.driver = handle.driver_version.strip()
        self.kind: Kind = _kind_of(handle)
        self.variant: Variant = variant or ("cpu" if self.kind == "cpu" else "gpu")
        self.compute_units = int(handle.max_compute_units)
        self.memory_bytes = int(handle.global_mem_size)
        self.shares_memory = self.kind == "cpu" if shares_memory is None else shares_memory
        self.supports_double = "cl_khr_fp64" in handle.extensions.split()
        self.lanes = CPU_LANES if self.variant == "cpu" else 1
        self.bytes_moved = 0
        self.lock = RLock()
        self.retired = Retired()
        self.uploads = Uploads(self)
        self._programs: dict[tuple[Any, ...], Program] = {}
        self._open: tuple[cl.Context, cl.CommandQueue] | None = None

    def __repr__(self) -> str:
        return f"Device({self.name!r}, {self.platform!r}, {self.kind}, {self.variant} kernels)"

    @property
    def context(self) -> cl.Context:
        """The context of this device alone.

        Raises:
            DeviceError: the driver refuses to open the device: it is in use, or broken.
        """
        return self._opened()[0]

    @property
    def queue(self) -> cl.CommandQueue:
        """The queue of this device, in which work runs in order.

        Raises:
            DeviceError: as for `context`.
        """
        return self._opened()[1]

    def _opened(self) -> tuple[cl.Context, cl.CommandQueue]:
        if self._open is None:
            with self.lock:  # or two threads would open it twice
                self._open = self._open or self._open_it()
        return self._open

    def _open_it(self) -> tuple[cl.Context, cl.CommandQueue]:
        if os.environ.get(CORRECT_CPU_NAME) == "1":
            correct_cpu_name(self._handle)
        try:
            context = cl.Context([self._handle])
            return context, cl.CommandQueue(context)
        except cl.Error as error:
            raise DeviceError(
                f"the device {self.name!r} could not be opened: {error}",
                where=self.platform,
                fix="choose another device; `stereogs doctor` lists them",
            ) from error

    @property
    def built_for(self) -> str | None:
        """The processor that an old PoCL was told to build kernels for ("skx": AVX-512), None where
        the driver chose for itself. Where it may yet be told, as it is at the latest when it refuses a
        build, something is built to find out.

        Raises:
            DeviceError: such a device cannot be opened, or nothing can be built for it.
        """
        if self.could_be_built_for:
            self.program(dtype=torch.float32)
        return told_cpu_name(self._handle)

    @property
    def could_be_built_for(self) -> str | None:
        """The processor that an old PoCL would be told with STEREOGS_CORRECT_CPU_NAME=1, None where it
        knows as much or was told."""
        return better_cpu_name(self._handle)

    def as_variant(self, variant: Variant) -> Device:
        """The same device with the other raster kernels; the GPU's run on a CPU too, only slower."""
        return Device(self._handle, variant, self.shares_memory)

    def as_discrete(self) -> Device:
        """The same device as if its memory were its own: whatever crosses is copied, and counted."""
        return Device(self._handle, self.variant, shares_memory=False)

    def allocate(
        self, elements: int, dtype: torch.dtype, over: Tensor | None
    ) -> tuple[cl.Buffer, Tensor | None]:
        """Memory for an array.

        Args:
            over: a CPU tensor to wrap instead, where memory is shared.

        Returns:
            A buffer of so many elements, and where memory is shared the flat tensor that it is.

        Raises:
            MemoryBudgetError: the driver or the host refused so much.
        """
        flags: int = cl.mem_flags.READ_WRITE
        size = elements * dtype.itemsize
        try:
            if not self.shares_memory:
                return cl.Buffer(self.context, flags, size=size), None
            host = (over if over is not None else torch.zeros(elements, dtype=dtype)).reshape(-1)
            flags |= cl.mem_flags.USE_HOST_PTR
            return cl.Buffer(self.context, flags, hostbuf=host.numpy()), host
        except (cl.Error, RuntimeError) as error:
            raise MemoryBudgetError(
                f"the device {self.name!r} did not give {size / 2**20:,.0f} MB: {error}",
                where=f"its memory is {self.memory_bytes / 2**20:,.0f} MB in all",
                fix="use fewer Gaussians or pixels, or free the device's memory",
            ) from error

    def program(self, *sources: str, dtype: torch.dtype, **defines: float) -> Program:
        """Build the named kernel files together, once for each combination of settings.

        Args:
            sources: "folder/name" for the file `kernels/name.cl` of one of the engine's folders;
                `device/lanes` is put in front.
            dtype: torch.float32 or torch.float64; decides what `real` is.
            defines: macros and their values.

        Raises:
            DeviceError: the device has no double precision, or its compiler refused the source.
        """
        key = (sources, dtype, tuple(sorted(defines.items())))
        with self.lock:
            if key not in self._programs:
                self._programs[key] = self._build(sources, dtype, defines)
            return self._programs[key]

    def _build(
        self, sources: tuple[str, ...], dtype: torch.dtype, defines: dict[str, float]
    ) -> Program:
        if dtype == torch.float64 and not self.supports_double:
            raise DeviceError(
                f"the device {self.name!r} does not compute in double precision",
                fix="use float32, or another device",
            )
        macros = {
            "LANES": self.lanes,
            "REAL_IS_DOUBLE": int(dtype == torch.float64),
            "HAS_DOUBLE": int(self.supports_double),
            **defines,
        }
        try:
            return Program(self, sources, macros)
        except DeviceError:
            # Only where the compiler does not know the processor, so that it can build nothing at all.
            if correct_cpu_name(self._handle, only_unknown=True):
                return Program(self, sources, macros)
            raise

    def finish(self) -> None:
        """Wait until everything enqueued has run."""
        with self.retired.drained():
            self.queue.finish()


def _kind_of(handle: cl.Device) -> Kind:
    if handle.type & cl.device_type.CPU:
        return "cpu"
    return "gpu" if handle.type & cl.device_type.GPU else "accelerator"
