"""The device that runs use: by name, or the fastest."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from ..errors import DeviceError
from .drivers import no_device

_VERSION = 2
"""Version of the measurement; remembered results of other versions are ignored."""


@dataclass(frozen=True)
class Description:
    """One device as its driver describes it.

    Args:
        index: in `list_devices`.
        compute_units: number of cores of a CPU.
        memory_bytes: size of its memory.
    """

    index: int
    name: str
    platform: str
    kind: str
    driver: str
    compute_units: int
    memory_bytes: int

    def is_named(self, part: str) -> bool:
        """Whether this is part of the platform's or device's name or the driver's version, in any case."""
        return part.lower() in f"{self.platform} {self.name} {self.driver}".lower()

    @property
    def key(self) -> str:
        """Equal for equal devices with equal drivers."""
        parts = (str(_VERSION), self.platform, self.name, self.driver, str(self.compute_units))
        return " | ".join(parts)


def choose(
    devices: Sequence[Description], name: str | None, seconds: Callable[[], Sequence[float]]
) -> int:
    """The position of the device to use.

    Args:
        name: part of its name, see `open_device`; None reads STEREOGS_DEVICE.
        seconds: returns the time of an iteration on each device, infinite if its self-test failed; called
            only if the choice depends on it.

    Raises:
        DeviceError: no device exists, or none has this name.
    """
    if not devices:
        raise no_device()
    wanted = name if name is not None else os.environ.get("STEREOGS_DEVICE")
    if wanted:
        for position, device in enumerate(devices):
            if device.is_named(wanted):
                return position
        found = ", ".join(f"{d.name!r} ({d.platform})" for d in devices)
        raise DeviceError(f"no OpenCL device is named {wanted!r}", fix=f"choose one of: {found}")
    if len(devices) == 1:
        return 0
    times = list(seconds())
    best = min(times)
    if math.isfinite(best):
        return times.index(best)
    # All fail: the error of the first GPU appears on use.
    return next((at for at, device in enumerate(devices) if device.kind == "gpu"), 0)
