"""Kernels: source, build and launch."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources

import numpy as np
import pyopencl as cl

from ..errors import DeviceError
from ..layout import KERNEL_HEADER
from .array import DeviceArray
from .drivers import INTEL
from .launch_plan import Launch, not_run
from .memory import DeviceMemory
from .signature import signatures

_PACKAGE = __package__.rpartition(".")[0]
_BUILD_OPTIONS = ("-cl-std=CL1.2", "-cl-no-signed-zeros")
_FOR_CPUS = ("-cl-mad-enable",)
"""Not for GPUs: a compiler may fuse the same products and sums in one kernel and not in another."""


@dataclass(frozen=True)
class KernelText:
    """A source that is not a file of this package; errors call it `name`."""

    name: str
    text: str


class Program:
    """Kernels built from one set of sources."""

    def __init__(
        self,
        device: DeviceMemory,
        sources: Sequence[str | KernelText],
        macros: Mapping[str, float],
    ) -> None:
        text = "\n".join([KERNEL_HEADER, *map(_source, ("device/lanes", *sources))])
        for_device = _FOR_CPUS if macros["LANES"] != 1 else ()
        defines = (f"-D{name}={value}" for name, value in macros.items())
        options = [*_BUILD_OPTIONS, *for_device, *defines]
        try:
            with warnings.catch_warnings():
                # Some compilers warn on every build, successful ones too; errors are raised below.
                warnings.simplefilter("ignore", cl.CompilerWarning)
                program = cl.Program(device.context, text).build(options=options)
        except cl.Error as error:
            texts = [source for source in sources if isinstance(source, KernelText)]
            names = [s.name if isinstance(s, KernelText) else s for s in sources]
            raise DeviceError(
                f"the OpenCL compiler of {device.name!r} failed on the kernels {', '.join(names)}",
                where=f"{device.platform}, driver {device.driver}\n{str(error)[:2000]}",
                fix=_fix(str(error), own_text=bool(texts)),
            ) from error
        self._device, self._program = device, program
        self._kernels = {kernel.function_name: kernel for kernel in program.all_kernels()}
        real = np.float64 if macros["REAL_IS_DOUBLE"] else np.float32
        self._signatures = signatures(text, real)
        for name, kernel in self._kernels.items():
            # pyopencl passes scalars of known types in a tenth of the time.
            kernel.set_scalar_arg_dtypes(self._signatures[name].types)

    def run(
        self,
        kernel: str,
        global_size: tuple[int, ...],
        local_size: tuple[int, ...] | None,
        /,
        **arguments: DeviceArray | float | np.generic,
    ) -> cl.Event:
        """Enqueue a kernel, and return its event.

        Args:
            local_size: If None, a GPU's driver chooses. On a CPU groups have one work-item: the driver would
                compile the kernel again for each image size, and could put all work-items into one group,
                which runs on one core.
            arguments: arrays and numbers by the names in the kernel's source, all of them, in any order.

        Raises:
            DeviceError: the driver rejected the launch.
            ExplainedError: names are missing or unknown, or types are wrong.
        """
        device = self._device
        values = self._signatures[kernel].values(arguments)
        if local_size is None and device.kind == "cpu":
            local_size = (1,) * len(global_size)
        try:
            # A kernel object stores its arguments, so only one thread at a time may set them.
            with device.lock:
                event: cl.Event = self._kernels[kernel](
                    device.queue, global_size, local_size, *values
                )
                device.retired.kernel_enqueued()
                return event
        except cl.Error as error:
            raise not_run(device, kernel, error) from error

    def prepare(
        self,
        kernel: str,
        global_size: tuple[int, ...],
        local_size: tuple[int, ...] | None,
        /,
        **arguments: DeviceArray | float | np.generic,
    ) -> Launch:
        """Set the arguments of a new kernel object, for a `LaunchPlan`. Parameters are those of `run`."""
        signature, own = self._signatures[kernel], cl.Kernel(self._program, kernel)
        values = zip(signature.values(arguments), signature.types, strict=True)
        for position, (value, number) in enumerate(values):
            own.set_arg(position, value if number is None else number(value))
        return Launch(own, global_size, local_size)


def _source(name: str | KernelText) -> str:
    if isinstance(name, KernelText):
        return name.text
    folder, _, file = name.partition("/")
    return resources.files(_PACKAGE).joinpath(folder, "kernels", f"{file}.cl").read_text("utf-8")


def _fix(message: str, *, own_text: bool) -> str:
    if "unknown target CPU" in message:  # Clang's words for a processor that is newer than itself
        return f"{INTEL}: it brings a newer driver, which knows the processor and is then used"
    if own_text:
        return "correct the source; the compiler counts its lines from 1"
    return "update the OpenCL driver, or choose another device; `stereogs doctor` lists them"
