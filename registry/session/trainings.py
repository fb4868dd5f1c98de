"""Training a pipeline, and going on with a training that was stopped."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..calls.read_only_guard import checked_plugins
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
from ..runs.options import RunOptions
from .arguments import console_of, device_of, run_folder
from .pipelines import PathLike, PipelineSource, build_pipeline

if TYPE_CHECKING:
    from ..runs.run import Run


def train(
    pipeline: PipelineSource,
    options: RunOptions | None = None,
    *,
    out: PathLike | Callable[[Pipeline, Scene], Path] | None = None,
    **changes: Any,
) -> Run:
    """Train a pipeline.

    Args:
        pipeline: a pipeline, or any source that `build_pipeline` accepts.
        options: how the training runs.
        out: the run folder, new or empty, or a function that returns it; None writes nothing to disk.
        changes: single fields of `RunOptions`, for example `callback=` or `scene=`.

    Returns:
        The run. It is not `finished` if the callback or Ctrl-C stopped it.

    Raises:
        ExplainedError: anything went wrong.
    """
    options = replace(options or RunOptions(), **changes)
    scene = options.scene
    checked = pipeline if isinstance(pipeline, Pipeline) else build_pipeline(pipeline)
    if scene is not None:
        checked = _for_given(checked, validate(scene))
    elif checked.one("scene").offer.name == IN_MEMORY:
        raise SceneError(
            "there is nothing to train on: the pipeline names no scene and none is given",
            fix="give one, train(pipeline, scene=...), or write scene: {use: ..., path: ...}",
        )
    from ..runs.training_run import start

    with _at_work(options.check_plugins, options.hang_after):
        return start(
            checked,
            device=device_of(options.device),
            out=Path(out).expanduser() if isinstance(out, str | os.PathLike) else out,
            console=console_of(options.progress),
            scene=scene,
            on_begin=options.on_begin,
            callback=options.callback,
            fit=options.fit,
        )


def resume(folder: PathLike, options: RunOptions | None = None, **changes: Any) -> Run:
    """Continue a run that was stopped, to the same result as if it had not been.

    Args:
        folder: the run folder.
        options, changes: as for `train`.

    Raises:
        ExplainedError: the folder is not a run, has no checkpoint, or anything goes wrong later.
    """
    options = replace(options or RunOptions(), **changes)
    path = run_folder(folder)
    from ..runs.training_run import resume as go_on

    with _at_work(options.check_plugins, options.hang_after):
        return go_on(
            path,
            plugins=Plugins(),
            device=device_of(options.device),
            console=console_of(options.progress),
            scene=options.scene and validate(options.scene),
            on_begin=options.on_begin,
            callback=options.callback,
            accept_changed_inputs=options.accept_changed_inputs,
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
