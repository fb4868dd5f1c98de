"""Tests of the engine run on every OpenCL device, or on those that STEREOGS_DEVICE names; on processors with
both raster variants."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from core_rasterizer import Device, DeviceError, list_devices
from core_rasterizer.device import Variant
from tests.core_rasterizer.quick_device import QuickDevice

VARIANTS: tuple[Variant, ...] = ("cpu", "gpu")


def _engines() -> list[QuickDevice]:
    wanted = os.environ.get("STEREOGS_DEVICE", "")
    devices = [device for device in list_devices() if device.describe(0).is_named(wanted)]
    return [
        QuickDevice(device, variant, device.shares_memory)
        for device in devices
        for variant in VARIANTS
        if variant == "gpu" or device.kind == "cpu"
    ]


def _label(device: Device) -> str:
    return f"{device.platform.split()[0]}-{device.name}-{device.variant} kernels".replace(" ", "_")


@pytest.fixture(params=_engines(), ids=_label, scope="session")
def device(request: pytest.FixtureRequest) -> QuickDevice:
    """A device with one of the two raster variants."""
    chosen: QuickDevice = request.param
    return chosen


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call() -> Iterator[None]:
    """Skip what needs double precision where the device lacks it."""
    try:
        yield
    except DeviceError as error:
        if "does not support double precision" in error.what:
            pytest.skip(error.what)
        raise
