"""OpenCL devices: choose one by name, build kernels once, share memory with torch where possible."""

from .array import DeviceArray
from .choice import list_devices, open_device
from .device import CORRECT_CPU_NAME, Device, Kind, Variant
from .program import Program
from .scratch import Scratch

__all__ = [
    "CORRECT_CPU_NAME",
    "Device",
    "DeviceArray",
    "Kind",
    "Program",
    "Scratch",
    "Variant",
    "list_devices",
    "open_device",
]
