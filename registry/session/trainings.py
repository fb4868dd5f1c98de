"""Training a pipeline, and going on with a training that was stopped."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from ..calls.loan import checked_plugins
from ..calls.watchdog import WATCHDOG
from ..contract.checks.scene import validate
from ..contract.in_memory import IN_MEMORY
from ..contract.scene import Scene
from ..errors import SceneError
from ..pipeline.edits import SECTIONS
from ..pipeline.pipeline import Item, Pipeline
from ..pipeline.schedule import HostSettings
from ..pipeline.yaml_source import Place
from ..plugins.discovery import Plugins
from .arguments import console_of, device_of, run_folder
from .pipelines import PathLike, PipelineSource, build_pipeline

if TYPE_CHECKING:
    from rich.console import Console

    from core_rasterizer import Device

    from ..runs.beginning import Fit
    from ..runs.run import Run
    from ..training.trainer import Iteration


def train(
    pipeline: PipelineSource,
    *,
    scene: Scene | None = None,
    out: PathLike | Callable[[Pipeline, Scene], Path] | None = None,
    progress: bool | Console = True,
    on_begin: Callable[[Run], None] | None = None,
    callback: Callable[[Iteration], bool | None] | None = None,
    device: Device | str | None = None,
    check_plugins: bool = False,
    hang_after: float | None = None,
    fit: Fit | None = None,
) -> Run:
    """Train a pipeline.

    Args:
        pipeline: a pipeline, or what `build_pipeline` makes one from.
        scene: trained on in place of what the pipeline's loader would load. The run's pipeline then says
            `scene: in_memory`, and `open_run` wants the scene again.
        out: the run folder, new or empty, or a function that names it; None writes nothing to disk.
        progress: whether to print how it goes; or the console to print on.
        on_begin: given the run once it has its first Gaussians, before the first iteration: to look at while
            it trains, not to change.
        callback: called after each iteration; training stops after one for which it returns False.
        device: the OpenCL device, or part of its name; None chooses.
        check_plugins: compare all that components are shown around each call; see `checked_plugins`.
        hang_after: seconds, > 0, after which a call into a component is ended, with a PluginError; one
            that does not heed that ends the process. In the main thread only; None ends none.
        fit: chooses the pipeline that goes on from the first Gaussians, see `within`; None: the same one.

    Returns:
        The run. It is not `finished` if the callback or Ctrl-C stopped it.

    Raises:
        ExplainedError: whatever went wrong.
    """
    checked = pipeline if isinstance(pipeline, Pipeline) else build_pipeline(pipeline)
    if scene is not None:
        checked = _for_given(checked, validate(scene))
    elif checked.one("scene").offer.name == IN_MEMORY:
        raise SceneError(
            "there is nothing to train on: the pipeline names no scene and none is given",
            fix="give one, train(pipeline, scene=...), or write scene: {use: ..., path: ...}",
        )
    from ..runs.training_run import start

    with _at_work(check_plugins, hang_after):
        return start(
            checked,
            device=device_of(device),
            out=Path(out).expanduser() if isinstance(out, str | os.PathLike) else out,
            console=console_of(progress),
            scene=scene,
            on_begin=on_begin,
            callback=callback,
            fit=fit,
        )


def within(seconds: float) -> Fit:
    """For `train(..., fit=within(20))`: as many iterations as fit into the seconds, from now to the end.

    The number follows from iterations that are measured on the scene and this machine, schedules go with it,
    and no more are done than the pipeline says. The run's pipeline, `run.pipeline`, has the number: trained
    again, it ends in the same bits.

    Args:
        seconds: of wall-clock time, > 0, scores and files included.
    """
    from ..choosing.fitting import Budget, fit_length

    budget, log = Budget(seconds, time.monotonic()), logging.getLogger("stereogs.choosing")
    return lambda beginning: fit_length(beginning, budget, log.info)


def resume(
    folder: PathLike,
    *,
    scene: Scene | None = None,
    progress: bool | Console = True,
    on_begin: Callable[[Run], None] | None = None,
    callback: Callable[[Iteration], bool | None] | None = None,
    device: Device | str | None = None,
    accept_changed_inputs: bool = False,
    check_plugins: bool = False,
    hang_after: float | None = None,
) -> Run:
    """Go on with a run that was stopped, to the same end as if it had not been; arguments as `train`'s.

    Args:
        accept_changed_inputs: go on although photographs, cameras or model files are not those that the
            run began with.

    Raises:
        ExplainedError: the folder is no run, has no checkpoint, or whatever goes wrong later.
    """
    path = run_folder(folder)
    from ..runs.training_run import resume as go_on

    with _at_work(check_plugins, hang_after):
        return go_on(
            path,
            plugins=Plugins(),
            device=device_of(device),
            console=console_of(progress),
            scene=scene and validate(scene),
            on_begin=on_begin,
            callback=callback,
            accept_changed_inputs=accept_changed_inputs,
        )


def _for_given(pipeline: Pipeline, scene: Scene) -> Pipeline:
    """The pipeline with a scene that is given in place of its own."""
    if pipeline.protocol is not None:
        raise SceneError(
            f"the protocol {pipeline.protocol.protocol.name!r} says nothing about a scene that is given",
            where=scene.name,
            fix='do without it: build_pipeline(..., ["protocol=null"])',
        )
    offer = Plugins(()).find(SECTIONS["scene"], IN_MEMORY)
    place = Place("the scene that is given")
    item = Item(IN_MEMORY, offer.settings_type(), HostSettings(use=IN_MEMORY), offer, place)
    return replace(pipeline, items={**pipeline.items, "scene": (item,)})


@contextmanager
def _at_work(check_plugins: bool, hang_after: float | None) -> Iterator[None]:
    """What holds for all of a training."""
    from ..training.threads import one_torch_thread

    with one_torch_thread(), checked_plugins(check_plugins), WATCHDOG.ending(hang_after):
        yield
