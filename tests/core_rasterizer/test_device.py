"""Devices and their buffers."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from types import SimpleNamespace

import pyopencl as cl
import pytest
import torch

from core_rasterizer import Device, DeviceError, GaussianModel, list_devices, open_device
from core_rasterizer.device import DeviceArray, device as device_module
from tests.core_rasterizer.scenes import parameters


@pytest.fixture
def no_device_opens(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A driver that lists its devices, but cannot open any."""

    def refuse(*_: object) -> None:
        raise cl.RuntimeError("clCreateContext failed: DEVICE_NOT_AVAILABLE")

    monkeypatch.setattr(cl, "Context", refuse)
    monkeypatch.setattr("core_rasterizer.device.memory._contexts", {})
    device_module._devices.cache_clear()
    yield
    device_module._devices.cache_clear()


def test_a_device_is_chosen_by_part_of_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    first = list_devices()[0]
    part = first.platform.split()[0].lower()
    assert open_device(part).platform == first.platform
    monkeypatch.setenv("STEREOGS_DEVICE", part)
    assert open_device().platform == first.platform


def test_an_unknown_name_lists_the_devices() -> None:
    with pytest.raises(DeviceError, match="no OpenCL device is named") as error:
        open_device("abacus")
    assert list_devices()[0].name in error.value.fix


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.int32, torch.int64])
def test_written_values_are_read_back(device: Device, dtype: torch.dtype) -> None:
    array = DeviceArray(device, (3, 5), dtype)
    assert not array.read().any()
    values = torch.arange(15).reshape(3, 5).to(dtype)
    array.write(values)
    assert torch.equal(array.read(), values)
    array.fill(7)
    assert (array.read() == 7).all()


def test_an_empty_array_is_allowed(device: Device) -> None:
    array = DeviceArray(device, (0, 3))
    array.write(torch.zeros(0, 3))
    assert array.read().shape == (0, 3)


def test_a_build_failure_is_explained(device: Device) -> None:
    with pytest.raises(DeviceError, match="failed on the kernels"):
        device.program("raster/scan", dtype=torch.float32)  # its macros are missing


class OtherVersion:
    """The first device's handle, but its driver names another version."""

    def __init__(self, version: str) -> None:
        self.version = version
        self._real = list_devices()[0]._handle

    def __getattr__(self, name: str) -> object:
        return getattr(self._real, name)


def test_a_driver_that_does_not_know_the_processor_is_left_out_if_there_is_another(
    no_device_opens: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """PoCL 3.0 on Zen 5: its version ends with "-generic", and nothing can be built."""
    unknown = OtherVersion("OpenCL 3.0 PoCL HSTR: pthread-x86_64-unknown-linux-gnu-generic")
    known = OtherVersion("OpenCL 3.0 (Build 0)")

    def listed(*handles: OtherVersion) -> list[object]:
        driver = SimpleNamespace(get_devices=lambda: handles)
        monkeypatch.setattr("core_rasterizer.device.device.platforms", lambda: [driver])
        device_module._devices.cache_clear()
        return [device._handle for device in list_devices()]

    assert listed(unknown, known) == [known]
    assert listed(unknown) == [unknown]


def test_a_processor_that_the_driver_does_not_know_needs_another_driver(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    def reject(*_: object, **__: object) -> None:
        raise cl.RuntimeError("clBuildProgram failed: error: unknown target CPU 'generic'")

    monkeypatch.setattr(cl.Program, "build", reject)
    with pytest.raises(DeviceError) as error:
        device.program("raster/scan", dtype=torch.float64)
    assert "pip install 'stereogs-rasterizer[intel]'" in error.value.fix


def test_a_device_that_cannot_be_opened_is_listed_and_chosen(no_device_opens: None) -> None:
    """The error is raised on first use."""
    first = list_devices()[0]
    assert open_device(first.platform).name == first.name
    with pytest.raises(DeviceError, match="could not be opened") as error:
        GaussianModel(parameters(16), first)
    assert "DEVICE_NOT_AVAILABLE" in error.value.what


def test_a_launch_failure_is_explained(device: Device) -> None:
    program = device.program("raster/scan", dtype=torch.float32, SCAN_GROUP=16, SCAN_ITEMS=1)
    array = DeviceArray(device, (16,), torch.int32)
    with pytest.raises(DeviceError, match="could not run the kernel scan_chunks"):
        program.run("scan_chunks", (16,), (3,), counts=array, totals=array, buckets=15, chunks=1)


def test_memory_of_an_array_lives_until_kernels_have_run(device: Device) -> None:
    if not device.shares_memory:
        pytest.skip("arrays of this device are not torch's memory")
    alone = device.as_variant(device.variant)  # no other arrays are freed on it
    program = alone.program("raster/scan", dtype=torch.float32, SCAN_GROUP=16, SCAN_ITEMS=1)
    array = DeviceArray(alone, (16,), torch.int32)
    totals = DeviceArray(alone, (17,), torch.int32)
    program.run("scan_chunks", (16,), (16,), counts=array, totals=totals, buckets=15, chunks=1)
    del array
    assert len(alone.retired) == 1
    totals.read()
    assert len(alone.retired) == 0
    del totals  # every kernel has run
    assert len(alone.retired) == 0


def test_importing_the_engine_loads_no_optional_package() -> None:
    heavy = {"kornia", "onnxruntime", "plyfile", "pycolmap", "scipy", "skimage"}
    code = f"import sys, core_rasterizer; print(*(set(sys.modules) & {heavy!r}))"
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert result.stdout.split() == []
