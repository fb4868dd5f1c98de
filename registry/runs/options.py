"""Options of a training, shared by `train`, `resume` and the Python API."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

    from core_rasterizer import Device

    from ..contract.scene import Scene
    from ..training.trainer import Iteration
    from .beginning import Fit
    from .run import Run


@dataclass(frozen=True)
class RunOptions:
    """How a training runs. None of these changes the result, except `fit` and `scene`.

    Args:
        scene: trains on this scene instead of the one that the pipeline names. The run's pipeline then says
            `scene: in_memory`, and `open_run` needs the scene again.
        progress: whether to print progress, or the console to print it on.
        on_begin: called with the run before the first iteration.
        callback: called after each iteration; training stops after one for which it returns False.
        device: the OpenCL device or part of its name; None chooses one.
        check_plugins: compares all data that components receive before and after each call (slower).
        hang_after: seconds after which a call into a component is interrupted with a PluginError; a call that
            does not react ends the process. Works in the main thread only. None: no limit.
        fit: chooses the pipeline that continues from the first Gaussians; None: the same pipeline.
        accept_changed_inputs: resumes even if photographs, cameras or model files have changed.
    """

    scene: Scene | None = None
    progress: bool | Console = True
    on_begin: Callable[[Run], None] | None = None
    callback: Callable[[Iteration], bool | None] | None = None
    device: Device | str | None = None
    check_plugins: bool = False
    hang_after: float | None = None
    fit: Fit | None = None
    accept_changed_inputs: bool = False
