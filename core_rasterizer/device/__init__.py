"""OpenCL devices: choose one by name, build kernels once, share memory with torch where possible."""

from .drivers import INTEL  # isort: skip - before pyopencl is imported
from .array import DeviceArray, Scratch
from .choice import Description, choose
from .device import Device, list_devices, open_device
from .host_pool import host_pool
from .launch_plan import Launch, LaunchPlan
from .memory import Kind
from .profile import DeviceProfile, Variant
from .program import KernelText, Program
from .trial import Trial, described, tried

__all__ = [
    "INTEL",
    "Description",
    "Device",
    "DeviceArray",
    "DeviceProfile",
    "KernelText",
    "Kind",
    "Launch",
    "LaunchPlan",
    "Program",
    "Scratch",
    "Trial",
    "Variant",
    "choose",
    "described",
    "host_pool",
    "list_devices",
    "open_device",
    "tried",
]
