"""OpenCL devices: choose one by name, build kernels once, share memory with torch where possible."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import resources
from typing import Any, Literal

import numpy as np
import pyopencl as cl
import torch
from torch import Tensor

from .errors import DeviceError, MemoryBudgetError
from .unknown_cpu import teach_processor_name

Kind = Literal["cpu", "gpu", "accelerator"]
Variant = Literal["cpu", "gpu"]

CPU_LANES = 8
"""Vector width of kernels on a CPU: eight floats fill an AVX register. Wider brought nothing, but to the
rasterizer, which chooses for itself (`kernels/lanes.cl`)."""

_BUILD_OPTIONS = ("-cl-std=CL1.2", "-cl-mad-enable", "-cl-no-signed-zeros")
_NUMPY_TYPES = {
    torch.float32: np.float32,
    torch.float64: np.float64,
    torch.int32: np.int32,
    torch.int64: np.int64,
    torch.uint8: np.uint8,
    torch.uint16: np.uint16,
}


class Device:
    """One OpenCL device with a queue of its own.

    Attributes:
        name, platform: as the driver reports them.
        kind: "cpu", "gpu" or "accelerator".
        variant: which raster kernels run: "cpu" (a work-item a tile, vectors along rows) or "gpu"
            (a work-item a pixel, a work-group a tile). Chosen by kind unless given.
        shares_memory: device buffers are host memory, so that torch sees them without a copy.
        bytes_moved: bytes copied between host and a device that does not share memory.
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
        try:
            self.context = cl.Context([handle])
            self.queue = cl.CommandQueue(self.context)
        except cl.Error as error:
            raise DeviceError(
                f"the device {self.name!r} could not be opened: {error}",
                where=self.platform,
                fix="choose another device; `stereogs doctor` lists them",
            ) from error
        self._programs: dict[tuple[Any, ...], Program] = {}

    def __repr__(self) -> str:
        return f"Device({self.name!r}, {self.platform!r}, {self.kind}, {self.variant} kernels)"

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
            sources: names of files in `kernels/` without their ending; `lanes` is put in front.
            dtype: torch.float32 or torch.float64; decides what `real` is.
            defines: macros and their values.

        Raises:
            DeviceError: the device has no double precision, or its compiler refused the source.
        """
        key = (sources, dtype, tuple(sorted(defines.items())))
        if key not in self._programs:
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
            self._programs[key] = Program(self, sources, macros)
        return self._programs[key]

    def finish(self) -> None:
        """Wait until everything enqueued has run."""
        self.queue.finish()


class Program:
    """Kernels built from one set of sources; each `cl.Kernel` is made once and kept."""

    def __init__(self, device: Device, sources: Sequence[str], macros: Mapping[str, float]) -> None:
        text = "\n".join(_source(name) for name in ("lanes", *sources))
        options = [*_BUILD_OPTIONS, *(f"-D{name}={value}" for name, value in macros.items())]
        try:
            with warnings.catch_warnings():
                # Some compilers report every build, successful ones too; errors are raised below.
                warnings.simplefilter("ignore", cl.CompilerWarning)
                program = cl.Program(device.context, text).build(options=options)
        except cl.Error as error:
            raise DeviceError(
                f"the OpenCL compiler of {device.name!r} refused the kernels {', '.join(sources)}",
                where=f"{device.platform}, driver {device.driver}\n{str(error)[:2000]}",
                fix="update the OpenCL driver, or choose another device; `stereogs doctor` lists them",
            ) from error
        self._queue = device.queue
        self._kernels = {kernel.function_name: kernel for kernel in program.all_kernels()}

    def run(
        self,
        kernel: str,
        global_size: tuple[int, ...],
        local_size: tuple[int, ...] | None,
        *arguments: DeviceArray | np.generic,
    ) -> None:
        """Enqueue a kernel. Arrays are passed as buffers, scalars as numpy scalars."""
        values = [a.buffer if isinstance(a, DeviceArray) else a for a in arguments]
        self._kernels[kernel](self._queue, global_size, local_size, *values)


class DeviceArray:
    """A contiguous array on a device.

    On a device that shares memory the array *is* a torch tensor (`tensor`), and `read` and `write`
    cost no copy of their own; elsewhere they move bytes, which `Device.bytes_moved` counts.

    Args:
        shape: of the array; a dimension may be zero.
        dtype: float32, float64, int32, int64, uint8 or uint16.
        over: wrap this CPU tensor instead of allocating; only where memory is shared.
    """

    def __init__(
        self,
        device: Device,
        shape: tuple[int, ...],
        dtype: torch.dtype = torch.float32,
        *,
        over: Tensor | None = None,
    ) -> None:
        self.device = device
        self.shape = shape
        self.dtype = dtype
        # OpenCL has no empty buffers, so an empty array keeps one element in reserve.
        elements = max(1, math.prod(shape))
        self.buffer, self._host = device.allocate(elements, dtype, over)
        if self._host is None:
            self.fill(0)

    def __del__(self) -> None:
        # A kernel under way may still use the host's memory, which OpenCL does not keep alive.
        if getattr(self, "_host", None) is not None:
            self.device.finish()

    @property
    def nbytes(self) -> int:
        """Bytes that the array's elements take."""
        return math.prod(self.shape) * self.dtype.itemsize

    def read(self, first: int = 0, last: int | None = None) -> Tensor:
        """Wait for the device and return rows `[first, last)` of the contents; by default all.

        Where memory is shared this is a view that later kernels will change; elsewhere a copy.
        """
        shape, begin, end = self._rows(first, last)
        if self._host is not None:
            self._map(self._host, cl.map_flags.READ)
            return self._host[begin:end].reshape(shape)
        result = torch.empty(shape, dtype=self.dtype)
        if result.numel():
            offset = begin * self.dtype.itemsize
            cl.enqueue_copy(self.device.queue, result.numpy(), self.buffer, src_offset=offset)
            self.device.bytes_moved += result.nbytes
        return result

    def write(self, values: Tensor, first: int = 0, last: int | None = None) -> None:
        """Replace rows `[first, last)`; `values` has their shape and is converted to the array's type."""
        shape, begin, end = self._rows(first, last)
        values = values.detach().to("cpu", self.dtype).reshape(shape).contiguous()
        if not values.numel():
            return
        if self._host is not None:
            self._map(self._host, cl.map_flags.WRITE)
            self._host[begin:end].copy_(values.reshape(-1))
        else:
            offset = begin * self.dtype.itemsize
            cl.enqueue_copy(self.device.queue, self.buffer, values.numpy(), dst_offset=offset)
            self.device.bytes_moved += values.nbytes

    def fill(self, value: int, first: int = 0, last: int | None = None) -> None:
        """Set every element of rows `[first, last)` to `value`; by default all."""
        _, begin, end = self._rows(first, last)
        if self._host is not None:
            self._map(self._host, cl.map_flags.WRITE)
            self._host[begin:end] = value
        elif begin < end:
            pattern = np.array(value, dtype=_NUMPY_TYPES[self.dtype])
            begin, end = begin * self.dtype.itemsize, end * self.dtype.itemsize
            cl.enqueue_fill_buffer(self.device.queue, self.buffer, pattern, begin, end - begin)

    def _rows(self, first: int, last: int | None) -> tuple[tuple[int, ...], int, int]:
        """Shape of a range of rows, and where its elements begin and end."""
        last = self.shape[0] if last is None else last
        row = math.prod(self.shape[1:])
        return (last - first, *self.shape[1:]), first * row, last * row

    def _map(self, host: Tensor, flags: Any) -> None:
        """Make the host's view current; only mapping promises that, though it copies nothing."""
        mapped: Any
        mapped, _ = cl.enqueue_map_buffer(
            self.device.queue,
            self.buffer,
            flags,
            0,
            (host.numel(),),
            np.dtype(_NUMPY_TYPES[self.dtype]),
        )
        mapped.base.release()


def list_devices() -> list[Device]:
    """Every OpenCL device that the installed drivers report, in the drivers' order."""
    return list(_devices())


def open_device(name: str | None = None) -> Device:
    """Choose a device.

    Args:
        name: part of a device's or platform's name, any case. None reads STEREOGS_DEVICE; without
            that, the first GPU is taken, else the first CPU.

    Raises:
        DeviceError: there is no OpenCL device, or none of that name.
    """
    devices = list_devices()
    if not devices:
        raise DeviceError(
            "no OpenCL platform was found",
            fix="install a driver: `pip install pocl-binary-distribution` brings one for any CPU",
        )
    wanted = name if name is not None else os.environ.get("STEREOGS_DEVICE")
    if wanted:
        for device in devices:
            if wanted.lower() in f"{device.platform} {device.name}".lower():
                return device
        found = ", ".join(f"{d.name!r} ({d.platform})" for d in devices)
        raise DeviceError(f"no OpenCL device is named {wanted!r}", fix=f"choose one of: {found}")
    return min(devices, key=lambda device: {"gpu": 0, "accelerator": 1, "cpu": 2}[device.kind])


@cache
def _devices() -> tuple[Device, ...]:
    try:
        platforms = cl.get_platforms()
    except cl.Error:  # the loader answers "no platform" with an error
        return ()
    handles = [handle for platform in platforms for handle in platform.get_devices()]
    for handle in handles:
        teach_processor_name(handle)
    return tuple(Device(handle) for handle in handles)


def _kind_of(handle: cl.Device) -> Kind:
    if handle.type & cl.device_type.CPU:
        return "cpu"
    return "gpu" if handle.type & cl.device_type.GPU else "accelerator"


def _source(name: str) -> str:
    return resources.files(__package__).joinpath("kernels", f"{name}.cl").read_text("utf-8")
