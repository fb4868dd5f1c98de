"""Which devices there are, and which one to take."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from functools import cache

import pyopencl as cl

from ..errors import DeviceError
from .device import Device


def list_devices() -> list[Device]:
    """Every OpenCL device that the installed drivers report, in the drivers' order.

    None of them is opened, so that one that is busy or broken does not hinder the others; it raises a
    `DeviceError` when it is used.
    """
    return list(_devices())


def open_device(name: str | None = None) -> Device:
    """Choose a device; it is opened when it is first used.

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
    return tuple(device for platform in platforms for device in _devices_of(platform))


def _devices_of(platform: cl.Platform) -> Iterator[Device]:
    """The devices of one driver; none of a driver that cannot say which it has."""
    with suppress(cl.Error):
        for handle in platform.get_devices():
            yield Device(handle)
