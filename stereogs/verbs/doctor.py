"""Find and test the OpenCL devices."""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from ..command_line.arguments import add_device
from ..command_line.command import Command
from ..command_line.output import console

if TYPE_CHECKING:
    from core_rasterizer.device import Description, Trial

_EPILOG = """\
examples:
  stereogs doctor
  stereogs doctor --device pocl     which device this name would choose

Each device renders three small scenes and differentiates them; the results are compared with a reference
computed in double precision. Then a training iteration is timed: if no device is named, runs use the
fastest. Each test has its own process, because a broken driver may end it. The first time, a driver may
compile kernels for a minute. Exit status 1 if a device computes wrongly or a driver is broken.
"""
_VENDORS = "OCL_ICD_VENDORS"
_NVIDIA = Path("/proc/driver/nvidia/version")
"""Exists where the driver of an NVIDIA card is loaded."""

_NOT_REGISTERED = """\
An NVIDIA card is not listed. Its OpenCL library may not be registered, as in
many containers; this registers it:
  mkdir -p /etc/OpenCL/vendors
  echo libnvidia-opencl.so.1 > /etc/OpenCL/vendors/nvidia.icd
If that does not help, install the library, which distributions package as
nvidia-opencl-icd or libnvidia-compute."""


class Doctor(Command):
    epilog = _EPILOG

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        add_device(parser)

    def run(self, arguments: argparse.Namespace) -> int:
        """Test every device; return 1 if one fails."""
        from core_rasterizer.device import choose, described, tried

        output = console()
        with tempfile.TemporaryDirectory() as folder:
            environment, devices = None, described()
            failed = isinstance(devices, str)
            if isinstance(devices, str):
                output.print(f"listing the devices FAILED: {devices}")
                environment = {**os.environ, _VENDORS: folder}
                for line in _leave_out_broken(Path(folder)):
                    output.print(line)
                devices = described(environment)
            if isinstance(devices, str):
                output.print(f"  also without these drivers: {devices}")
                return 1
            trials = [tried(device, environment) for device in devices]
            chosen = choose(devices, arguments.device, lambda: [t.seconds for t in trials])
        for position, (device, trial) in enumerate(zip(devices, trials, strict=True)):
            failed |= trial.failure is not None
            output.print(_lines(device, trial, is_chosen=position == chosen))
        if _NVIDIA.exists() and not any(device.is_named("nvidia") for device in devices):
            output.print(_NOT_REGISTERED)
        return 1 if failed else 0


def _lines(device: Description, trial: Trial, *, is_chosen: bool) -> str:
    """What is printed for one device."""
    mark = "  <- chosen" if is_chosen else ""
    return (
        f"{device.name} ({device.platform}, {device.kind}, driver {device.driver}){mark}\n"
        f"  {device.compute_units} compute units, {device.memory_bytes / 1e9:.1f} GB\n"
        f"  self-test: {_verdict(trial)}"
    )


def _verdict(trial: Trial) -> str:
    numbers = (
        f"image error {trial.image_error:.1e}, depth error {trial.depth_error:.1e}, "
        f"gradient error {trial.gradient_error:.1e}"
    )
    if trial.failure is None:
        return f"passed, {numbers}\n  training iteration: {1000 * trial.seconds:.1f} ms"
    measured = trial.image_error == trial.image_error  # else the test ended before
    return f"FAILED: {trial.failure}" + (f", {numbers}" if measured else "")


def _leave_out_broken(folder: Path) -> Iterator[str]:
    """Copy the files of those drivers to `folder` that can list their devices alone; yield a line for others.

    Drivers are libraries that .icd files name; OpenCL loads all of them into each process.
    """
    from core_rasterizer.device import described

    for file in _driver_files():
        answer = described({**os.environ, _VENDORS: str(file)})
        if isinstance(answer, str):
            yield (
                f"{file} FAILED: {answer}\n"
                f"  update or remove this driver, or set {_VENDORS} to a folder of other .icd files"
            )
        else:
            (folder / file.name).write_bytes(file.read_bytes())


def _driver_files() -> list[Path]:
    """The .icd files that the OpenCL loader reads on Linux."""
    place = Path(os.environ.get(_VENDORS) or "/etc/OpenCL/vendors")
    return sorted(place.glob("*.icd")) if place.is_dir() else [place]
