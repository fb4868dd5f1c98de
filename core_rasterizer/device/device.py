"""OpenCL devices and the kernels built for them."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from typing import Any

import pyopencl as cl
import torch

from ..errors import DeviceError
from .choice import Description, choose
from .drivers import platforms
from .memory import DeviceMemory
from .profile import DeviceProfile, Variant
from .program import KernelText, Program
from .trial import seconds_of
from .uploads import Uploads

_log = logging.getLogger(__name__)


class Device(DeviceMemory):
    """One OpenCL device with its own queue, opened on first use.

    Threads may share it; hold `lock` while using memory that other threads use as well.

    Attributes:
        variant: raster kernels: "cpu" (one work-item per tile, vectors along rows) or "gpu" (one
            work-item per pixel, one work-group per tile). Chosen by kind unless given.
        profile: how kernels divide their work.
        uploads: copies of tensors that do not change on the host.
    """

    def __init__(
        self,
        handle: cl.Device,
        variant: Variant | None = None,
        shares_memory: bool | None = None,
    ) -> None:
        super().__init__(handle, shares_memory)
        self.variant: Variant = variant or ("cpu" if self.kind == "cpu" else "gpu")
        self.compute_units = int(handle.max_compute_units)
        self.supports_double = "cl_khr_fp64" in handle.extensions.split()
        self.profile = DeviceProfile.for_device(self.variant, self.compute_units)
        self.uploads = Uploads(self)
        self._programs: dict[tuple[Any, ...], Program] = {}

    def __repr__(self) -> str:
        return f"Device({self.name!r}, {self.platform!r}, {self.kind}, {self.variant} kernels)"

    @property
    def lanes(self) -> int:
        """Reals per vector of the kernels; rasterizer, SSIM and the ZNCC sweep have their own."""
        return self.profile.lanes

    def describe(self, index: int) -> Description:
        """What the driver says of it; `index` is its position in `list_devices`."""
        return Description(
            index,
            self.name,
            self.platform,
            self.kind,
            self.driver,
            self.compute_units,
            self.memory_bytes,
        )

    def as_variant(self, variant: Variant) -> Device:
        """The same device with other raster kernels; the GPU's also run on a CPU, slowly."""
        return Device(self._handle, variant, self.shares_memory)

    def as_discrete(self) -> Device:
        """The same device without shared memory: transfers are copied and counted."""
        return Device(self._handle, self.variant, shares_memory=False)

    def program(self, *sources: str | KernelText, dtype: torch.dtype, **defines: float) -> Program:
        """Build kernel files together, once for each combination of settings.

        Args:
            sources: "folder/name" for the file `folder/kernels/name.cl`, or a text;
                `device/lanes` comes first.
            dtype: torch.float32 or torch.float64, the type `real` of the kernels.
            defines: macros and their values.

        Raises:
            DeviceError: the device lacks double precision, or its compiler rejects the source.
        """
        key = (sources, dtype, tuple(sorted(defines.items())))
        with self.lock:
            if key not in self._programs:
                self._programs[key] = self._build(sources, dtype, defines)
            return self._programs[key]

    def _build(
        self, sources: tuple[str | KernelText, ...], dtype: torch.dtype, defines: dict[str, float]
    ) -> Program:
        if dtype == torch.float64 and not self.supports_double:
            raise DeviceError(
                f"the device {self.name!r} does not support double precision",
                fix="use float32, or another device",
            )
        macros = {
            "LANES": self.lanes,
            "REAL_IS_DOUBLE": int(dtype == torch.float64),
            "HAS_DOUBLE": int(self.supports_double),
            **defines,
        }
        return Program(self, sources, macros)


def list_devices() -> list[Device]:
    """Every OpenCL device of the installed drivers, in the drivers' order.

    A driver whose compiler does not know the processor is left out if there is another. Devices are opened
    on first use, so a busy or broken one raises its `DeviceError` only then.
    """
    return list(_devices())


def open_device(name: str | None = None) -> Device:
    """Choose a device; it is opened on first use.

    Args:
        name: part of a device's or platform's name or of its driver's version, in any case. None reads
            STEREOGS_DEVICE; if that is unset and there are several devices, the one that trained fastest in
            a self-test is chosen. The test takes seconds and is remembered for each device and driver.

    Raises:
        DeviceError: no OpenCL device exists, or none has this name.
    """
    devices = list_devices()
    described = [device.describe(index) for index, device in enumerate(devices)]
    return devices[choose(described, name, _seconds)]


@cache
def _seconds() -> list[float]:
    """Time of an iteration on each device."""
    devices = list_devices()
    _log.info("timing %d OpenCL devices, once for each driver", len(devices))
    return seconds_of([device.describe(index) for index, device in enumerate(devices)])


@cache
def _devices() -> tuple[Device, ...]:
    found = tuple(device for platform in platforms() for device in _devices_of(platform))
    return tuple(device for device in found if _knows_processor(device)) or found


def _knows_processor(device: Device) -> bool:
    """Whether the driver's compiler knows this processor.

    The LLVM of an old PoCL calls a processor that is newer than itself "generic" and then rejects that name
    as a target, so every build fails (PoCL 3.0 from pip, LLVM 14, on Zen 5).
    """
    if not device._handle.version.endswith("-generic"):
        return True
    try:
        device.program(dtype=torch.float32)
    except DeviceError:
        return False
    return True


def _devices_of(platform: cl.Platform) -> Iterator[Device]:
    """The devices of one driver; none if the driver cannot list them."""
    with suppress(cl.Error):
        for handle in platform.get_devices():
            yield Device(handle)
