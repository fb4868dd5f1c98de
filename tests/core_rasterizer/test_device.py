"""Devices and their buffers."""

from __future__ import annotations

import pytest
import torch

from core_rasterizer import Device, DeviceError, list_devices, open_device
from core_rasterizer.device import DeviceArray


def test_a_device_is_chosen_by_part_of_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    first = list_devices()[0]
    part = first.platform.split()[0].lower()
    assert open_device(part).platform == first.platform
    monkeypatch.setenv("STEREOGS_DEVICE", part)
    assert open_device().platform == first.platform


def test_an_unknown_name_lists_what_there_is() -> None:
    with pytest.raises(DeviceError, match="no OpenCL device is named") as error:
        open_device("abacus")
    assert list_devices()[0].name in error.value.fix


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.int32, torch.int64])
def test_what_is_written_is_read(device: Device, dtype: torch.dtype) -> None:
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


def test_a_kernel_that_does_not_build_is_explained(device: Device) -> None:
    with pytest.raises(DeviceError, match="refused the kernels"):
        device.program("raster/scan", dtype=torch.float32)  # its macros are missing
