"""Devices and their buffers."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator

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
