"""Launches that are enqueued again and again with the same arguments."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import pyopencl as cl

from ..errors import DeviceError
from .memory import DeviceMemory


class Launch(NamedTuple):
    """A kernel object with its arguments set, and the sizes of its launch."""

    kernel: cl.Kernel
    global_size: tuple[int, ...]
    local_size: tuple[int, ...] | None


class LaunchPlan:
    """Launches that are prepared once, and enqueued as long as their inputs are the same.

    To turn names and numbers into the arguments of a kernel takes Python longer than to enqueue it.
    """

    def __init__(self) -> None:
        self._inputs: tuple[object, ...] = ()
        self._launches: tuple[Launch, ...] = ()

    def is_for(self, *inputs: object) -> bool:
        """Whether the launches were prepared for these arrays, which are the same objects, and numbers."""
        return self._inputs == inputs

    def prepare(self, launches: Iterable[Launch], *inputs: object) -> None:
        """Replace the launches; `inputs` are all arrays and numbers that they depend on."""
        self._launches = tuple(launches)
        self._inputs = inputs  # keeps the arrays' memory too, which kernel objects do not

    def enqueue(self, device: DeviceMemory) -> None:
        """Enqueue the launches in order.

        Raises:
            DeviceError: the driver rejected one.
        """
        queue = device.queue
        with device.lock:
            try:
                for launch in self._launches:
                    cl.enqueue_nd_range_kernel(queue, *launch)
            except cl.Error as error:
                raise not_run(device, launch.kernel.function_name, error) from error
            finally:
                device.retired.kernel_enqueued()


def not_run(device: DeviceMemory, kernel: str, error: cl.Error) -> DeviceError:
    """The error for a launch that the driver rejected."""
    return DeviceError(
        f"the device {device.name!r} could not run the kernel {kernel}: {error}",
        where=f"{device.platform}, driver {device.driver}",
        fix="choose another device; `stereogs doctor` tests them",
    )
