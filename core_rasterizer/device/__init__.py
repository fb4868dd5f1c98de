"""OpenCL devices: choose one by name, build kernels once, share memory with torch where possible."""

from .array import DeviceArray, Scratch
from .device import Device, Kind, Variant, list_devices, open_device
from .host_pool import host_pool
from .memory import CORRECT_CPU_NAME
from .program import Program

__all__ = [
    "CORRECT_CPU_NAME",
    "Device",
    "DeviceArray",
    "Kind",
    "Program",
    "Scratch",
    "Variant",
    "host_pool",
    "list_devices",
    "open_device",
]
