"""What several functions take in several forms: a device, a console, a run's folder."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from .pipelines import PathLike

if TYPE_CHECKING:
    from rich.console import Console

    from core_rasterizer import Device


def device_of(device: Device | str | None) -> Device:
    """A device, the one of that name, or a chosen one."""
    from core_rasterizer import open_device

    return open_device(device) if device is None or isinstance(device, str) else device


def console_of(progress: bool | Console) -> Console:
    """A console, one of our own, or one that keeps silent."""
    from rich.console import Console

    from ..messages.terminal import PlainConsole

    if isinstance(progress, Console):
        return progress
    return PlainConsole(markup=False, highlight=False, soft_wrap=True, quiet=not progress)


def run_folder(folder: PathLike) -> Path:
    """A run's folder, refused before torch is imported if it is none."""
    from ..runs.folder import RunFolder

    return RunFolder.existing(Path(folder).expanduser()).path
