"""Find and test the OpenCL devices."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from registry import Command, Register, hookimpl
from registry.commands import add_device, console

if TYPE_CHECKING:
    from core_rasterizer import Device


class Doctor(Command):
    epilog = """\
examples:
  stereogs doctor
  stereogs doctor --device pocl     which device this name would choose

Each device renders a small scene and differentiates it; the result is compared with a reference
computed in double precision. The first time, a driver may compile kernels for a minute.
Exit status 1 if a device computes wrongly.
"""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        add_device(parser)

    def run(self, arguments: argparse.Namespace) -> int:
        """Test every device; return 1 if one fails."""
        from core_rasterizer import list_devices, open_device

        output = console()
        chosen = open_device(arguments.device)
        failed = False
        for device in list_devices():
            passed, verdict = _test(device)
            failed |= not passed
            mark = "  <- chosen" if device is chosen else ""
            output.print(
                f"{device.name} ({device.platform}, {device.kind}, driver {device.driver}){mark}\n"
                f"  {device.compute_units} compute units, {device.memory_bytes / 1e9:.1f} GB\n"
                f"  self-test: {verdict}" + (_kernels(device) if passed else "")
            )
        return 1 if failed else 0


def _kernels(device: Device) -> str:
    """Return a line on the processor that kernels are built for, if an old driver does not know it."""
    from core_rasterizer import CORRECT_CPU_NAME

    if device.built_for:
        return f"\n  kernels are built for {device.built_for}, which the driver was told"
    if better := device.could_be_built_for:
        return f"\n  {CORRECT_CPU_NAME}=1 has faster kernels built, for {better} (docs/limits.md)"
    return ""


def _test(device: Device) -> tuple[bool, str]:
    """Return whether the device passed, and the verdict in words."""
    from core_rasterizer import ExplainedError, check_device
    from registry.training import one_torch_thread

    try:
        with one_torch_thread():
            verdict = check_device(device)
    except ExplainedError as error:
        return False, f"FAILED: {error.what}"
    except Exception as error:  # broken drivers raise anything
        return False, f"FAILED: {type(error).__name__}: {error}"
    numbers = f"image error {verdict.image_error:.1e}, gradient error {verdict.gradient_error:.1e}"
    return verdict.passed, f"{'passed' if verdict.passed else 'FAILED'}, {numbers}"


@hookimpl
def stereogs_register_commands(register: Register[Command]) -> None:
    register("doctor", Doctor)
