"""Tests of the engine run on every OpenCL device, with both raster variants."""

from __future__ import annotations

import pytest

from core_rasterizer import Device, list_devices


def _engines() -> list[Device]:
    return [device.as_variant(variant) for device in list_devices() for variant in ("cpu", "gpu")]


def _label(device: Device) -> str:
    return f"{device.platform.split()[0]}-{device.name}-{device.variant} kernels".replace(" ", "_")


@pytest.fixture(params=_engines(), ids=_label, scope="session")
def device(request: pytest.FixtureRequest) -> Device:
    """A device with one of the two raster variants."""
    chosen: Device = request.param
    return chosen
