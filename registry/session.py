"""The host from Python: what the verbs of the command line do, as functions, with or without files.

    import stereogs

    pipeline = stereogs.build_pipeline("pipelines/3dgs.yaml", ["scene.path=photos"])
    run = stereogs.train(pipeline, callback=lambda done: print(done.number, done.loss))
    rgb, depth, alpha = run.render(run.scene.test[0].camera)

The command line calls the same functions. Importing this module is quick; torch is imported by the first
function that computes something.
"""

from __future__ import annotations

import json
import logging
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .calls.loan import checked_plugins
from .calls.watchdog import WATCHDOG
from .contract.in_memory import IN_MEMORY
from .contract.scene import PointCloud, Scene, View, validate
from .errors import PipelineError, SceneError
from .pipeline.edits import SECTIONS
from .pipeline.pipeline import Item, Pipeline
from .pipeline.pipeline import build_pipeline as checked_pipeline
from .pipeline.ready import find_pipeline
from .pipeline.schedule import HostSettings
from .pipeline.yaml_source import Node, Place, parse, read, to_yaml
from .plugins.discovery import Plugins

if TYPE_CHECKING:
    from numpy.typing import ArrayLike
    from rich.console import Console

    from core_rasterizer import Camera, Device, GaussianModel

    from .inspection.scene_source import FoundLoader
    from .runs.run import Picture, Run
    from .runs.training_run import Fit
    from .training.trainer import Iteration

PathLike = str | os.PathLike[str]
PipelineSource = Pipeline | Mapping[str, Any] | PathLike
"""A pipeline, or what `build_pipeline` makes one from."""


def build_pipeline(
    source: Mapping[str, Any] | PathLike,
    overrides: Sequence[str] = (),
    disable: Sequence[str] = (),
    *,
    plugins: Plugins | None = None,
) -> Pipeline:
    """A checked pipeline. Without a `scene` it is one for a scene that is given to `train`.

    Args:
        source: plain values as a pipeline file holds them; the path of a pipeline file, or the name of
            a ready one; or, if it is a `str` with a line break or a "{" at its start, YAML text.
        overrides: `a.b=value`, as for `--set`; applied before `disable`.
        disable: names of components to switch off, as for `--disable`.
        plugins: where components are looked for; None: the installed plugins.

    Raises:
        PipelineError: anything wrong with it, with its line.
        PluginError: a component that it names cannot be loaded.
    """
    root = _tree(source)
    if isinstance(root.content, dict) and not any(
        text.partition("=")[0].strip().startswith("scene") for text in overrides
    ):
        written = root.content.get("scene")
        if written is None or written.content is None:
            root.content["scene"] = Node(IN_MEMORY, root.place)
    return checked_pipeline(root, plugins or Plugins(), overrides, disable)


def load_scene(
    source: PipelineSource,
    changes: Sequence[str] = (),
    *,
    format_name: str | None = None,
    device: Device | str | None = None,
) -> Scene:
    """The photographs and cameras of a folder, or of a pipeline.

    Args:
        source: a folder of photographs or of a data set; a pipeline, or its file, text or values.
        changes: `key=value`, settings of the loader; a pipeline that is built has its own.
        format_name: the loader for a folder; None asks the loaders which one knows it.
        device: see `train`.

    Raises:
        ExplainedError: nothing is there, no loader or several know the folder, or what the loader says.
    """
    found = _loader(source, changes, format_name)
    from .inspection.scene_source import load
    from .training.threads import one_torch_thread

    with one_torch_thread():
        return load(found, _device(device))


def scene_from_arrays(
    images: Sequence[ArrayLike],
    cameras: Sequence[Camera],
    *,
    bounds: tuple[float, float],
    test: Sequence[int] = (),
    points: PointCloud | None = None,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    name: str = "scene",
) -> Scene:
    """A checked scene of photographs that are arrays; views are named view_000, view_001, ...

    Args:
        images: each `[H, W, 3]`, uint8, or floating point in [0, 1].
        cameras: one for each image, of its size.
        bounds: (near, far) z-depth of the scene's content in world units, 0 < near < far.
        test: indices of the images that test; the others train.
        points: sparse points to start from, or None: the initializer finds its own.
        background: colour behind the scene, three numbers in [0, 1].
        name: for titles and tables.

    Raises:
        SceneError: there are not as many cameras as images, an index of `test` that is none, or anything
            else that training could not use (`registry.validate`).
    """
    if len(images) != len(cameras):
        raise SceneError(
            f"there are {len(images)} images and {len(cameras)} cameras",
            where=name,
            fix="give one camera for each image",
        )
    unknown = [index for index in test if not 0 <= index < len(images)]
    if unknown:
        raise SceneError(
            f"there is no image {unknown[0]} to test; there are {len(images)}",
            where=name,
            fix="count from 0",
        )
    views = [
        View(f"view_{index:03d}", camera, _colors(image))
        for index, (image, camera) in enumerate(zip(images, cameras, strict=True))
    ]
    train = tuple(view for index, view in enumerate(views) if index not in test)
    tested = tuple(views[index] for index in test)
    return validate(Scene(name, train, tested, bounds, points, background))


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
    from .runs.training_run import start

    with _at_work(check_plugins, hang_after):
        return start(
            checked,
            device=_device(device),
            out=Path(out).expanduser() if isinstance(out, str | os.PathLike) else out,
            console=_console(progress),
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
    from .choosing.fitting import Budget, fit_length

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
    path = _run_folder(folder)
    from .runs.training_run import resume as go_on

    with _at_work(check_plugins, hang_after):
        return go_on(
            path,
            plugins=Plugins(),
            device=_device(device),
            console=_console(progress),
            scene=scene and validate(scene),
            on_begin=on_begin,
            callback=callback,
            accept_changed_inputs=accept_changed_inputs,
        )


def open_run(
    folder: PathLike,
    *,
    scene: Scene | None = None,
    device: Device | str | None = None,
    accept_changed_inputs: bool = False,
) -> Run:
    """A run that was made earlier: its pipeline, scene and Gaussians as its folder keeps them.

    Args:
        folder: what training wrote.
        scene: what it was trained on, if that was made in memory.
        device: see `train`.

    Raises:
        ExplainedError: the folder is no run, or something in it cannot be read.
    """
    path = _run_folder(folder)
    from .runs.training_run import open_run as opened
    from .training.threads import one_torch_thread

    with one_torch_thread():
        return opened(
            path,
            plugins=Plugins(),
            device=_device(device),
            scene=scene and validate(scene),
            accept_changed_inputs=accept_changed_inputs,
        )


def export(
    run: Run,
    format_name: str,
    folder: PathLike | None = None,
    *,
    changes: Sequence[str] = (),
    without: Sequence[str] = (),
) -> list[Path]:
    """Write a run for other programs, by any exporter that is installed.

    Args:
        format_name: the exporter, as a pipeline names it: "ply", "gltf", ...
        folder: to write into, created if need be; None: the run folder's exports.
        changes: `key=value`, settings of the exporter.
        without: kinds of initial points whose Gaussians are left out, for example "margin"; see
            `Run.kinds`.

    Returns:
        The files that were written.

    Raises:
        ExplainedError: no such exporter or kind, wrong settings, no folder, or what the exporter says.
    """
    from .exporting import export as written
    from .runs.results import EXPORTS
    from .training.threads import one_torch_thread

    item = find_exporter(format_name, changes)
    place = Path(folder).expanduser() if folder else run.folder_or_refuse().path / EXPORTS
    with one_torch_thread():
        return written(run, item, place, without)


def find_exporter(format_name: str, changes: Sequence[str] = ()) -> Item:
    """What `export` is asked for, refused at once where it cannot be had.

    Raises:
        ExplainedError: no such exporter, or wrong settings.
    """
    from .inspection.single_item import qualified, single_item

    point = SECTIONS["exporters"]
    offer = Plugins().find(point, format_name)
    return single_item(offer, [qualified(text, point.section) for text in changes])


def render(
    source: Run | GaussianModel,
    camera: Camera,
    *,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Picture:
    """A camera as numpy arrays: rgb `[H, W, 3]` in [0, 1], depth and alpha `[H, W]`.

    Args:
        source: a run, which knows its background, or Gaussians alone.
        background: behind Gaussians alone, three numbers in [0, 1].
    """
    from .runs.evaluation import clamped_render
    from .runs.run import Run, as_arrays

    if isinstance(source, Run):
        return source.render(camera)
    return as_arrays(clamped_render(source, camera, background))


def results(folder: PathLike) -> dict[str, Any]:
    """What results.json of a run folder holds; empty before the run has ended.

    Raises:
        RunError: the folder is no run, or the file is damaged.
    """
    from .runs.folder import RunFolder

    return RunFolder.existing(Path(folder).expanduser()).results()


@contextmanager
def _at_work(check_plugins: bool, hang_after: float | None) -> Iterator[None]:
    """What holds for all of a training."""
    from .training.threads import one_torch_thread

    with one_torch_thread(), checked_plugins(check_plugins), WATCHDOG.ending(hang_after):
        yield


def _loader(source: PipelineSource, changes: Sequence[str], format_name: str | None) -> FoundLoader:
    from .inspection.scene_source import FoundLoader, find_loader

    if isinstance(source, str | os.PathLike) and not _is_text(source):
        return find_loader(
            Path(source).expanduser(), Plugins(), format_name=format_name, changes=changes
        )
    if not isinstance(source, Pipeline):
        source = build_pipeline(source, [f"scene.{x.removeprefix('scene.')}" for x in changes])
    elif changes:
        raise PipelineError(
            "a pipeline that is built cannot be changed", fix="give the changes to build_pipeline"
        )
    return FoundLoader(source.one("scene"), source.training.seed)


def _tree(source: Mapping[str, Any] | PathLike) -> Node:
    if isinstance(source, Mapping):
        try:
            text = to_yaml(json.loads(json.dumps(source, default=_plain)))
        except TypeError as error:
            raise PipelineError(
                f"a pipeline is made of plain values: {error}",
                where="the pipeline's values",
                fix="use dicts, lists, texts, numbers, True, False and None",
            ) from error
        return parse(text, "the pipeline's values", has_lines=False)
    if _is_text(source):
        return parse(str(source), "the pipeline's text")
    return read(find_pipeline(Path(source).expanduser()))


def _plain(value: object) -> object:
    """What JSON does not know and a pipeline may hold."""
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    raise TypeError(f"{value!r} is a {type(value).__name__}")


def _is_text(source: PathLike) -> bool:
    return isinstance(source, str) and ("\n" in source or source.lstrip().startswith("{"))


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


def _colors(image: ArrayLike) -> Any:
    """`[H, W, 3]` float32 in [0, 1]; what is no such image is left for `validate` to refuse."""
    import numpy as np
    import torch

    array = np.asarray(image)
    scale = 255 if array.dtype == np.uint8 else 1
    return torch.from_numpy((array / np.float32(scale)).astype(np.float32))


def _device(device: Device | str | None) -> Device:
    from core_rasterizer import open_device

    return open_device(device) if device is None or isinstance(device, str) else device


def _console(progress: bool | Console) -> Console:
    from rich.console import Console

    from .messages.terminal import PlainConsole

    if isinstance(progress, Console):
        return progress
    return PlainConsole(markup=False, highlight=False, soft_wrap=True, quiet=not progress)


def _run_folder(folder: PathLike) -> Path:
    """A run's folder, refused before torch is imported if it is none."""
    from .runs.folder import RunFolder

    return RunFolder.existing(Path(folder).expanduser()).path
