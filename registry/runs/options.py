"""Options of a training, shared by `train`, `resume` and the Python API."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

    from rich.console import Console

    from core_rasterizer import Device, Engine

    from ..contract.scene import Scene
    from ..training.trainer import Iteration
    from .run import Run


@dataclass(frozen=True)
class RunOptions:
    """How a training runs. None of these changes the result, except `scene` and a recovery.

    Args:
        scene: trains on this scene instead of the one that the pipeline names. The run's pipeline then says
            `scene: in_memory`, and `open_run` needs the scene again.
        scene_folder: folder of a resumed run's photographs, if they were moved.
        progress: whether to print progress, or the console to print it on.
        on_begin: called with the run before the first iteration.
        callback: called after each iteration; training stops after one for which it returns False.
        device: the OpenCL device, part of its name, or another engine; None chooses a device.
        check_plugins: compares all data that components receive before and after each call, and repeats some
            calls (slower).
        hang_after: seconds after which a call into a component is interrupted with a PluginError; a call that
            does not react ends the process. Works in the main thread only. None: no limit.
        recover: if a parameter is not finite, goes back to the last checkpoint with half the learning rates,
            at most five times; a run without a folder cannot.
        accept_changed_inputs: resumes even if photographs, cameras or model files have changed.
        accept_changed_plugins: resumes even if the package of a component has another version or code.
    """

    scene: Scene | None = None
    scene_folder: Path | None = None
    progress: bool | Console = True
    on_begin: Callable[[Run], None] | None = None
    callback: Callable[[Iteration], bool | None] | None = None
    device: Device | Engine | str | None = None
    check_plugins: bool = False
    hang_after: float | None = None
    recover: bool = False
    accept_changed_inputs: bool = False
    accept_changed_plugins: bool = False

    def console(self) -> Console:
        """Return the console for progress, silent if `progress` is False."""
        from ..messages.terminal import PlainConsole

        if not isinstance(self.progress, bool):
            return self.progress
        return PlainConsole(markup=False, highlight=False, soft_wrap=True, quiet=not self.progress)


def find_device(device: Device | Engine | str | None) -> Device | Engine:
    """Return the device or engine itself, the device with this name, or for None a chosen one."""
    from core_rasterizer import open_device

    return open_device(device) if device is None or isinstance(device, str) else device
