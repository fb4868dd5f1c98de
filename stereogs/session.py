"""The Python API, which the command line uses too.

    import stereogs

    pipeline = stereogs.build_pipeline("pipelines/3dgs.yaml", ["scene.path=photos"])
    run = stereogs.train(pipeline, callback=lambda done: print(done.number, done.loss))
    rgb, depth, alpha = run.render(run.scene.test[0].camera)

Importing this module is fast: torch is imported by the first function that computes something.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from registry.calls.process_state import one_torch_thread
from registry.contract.checks.scene import validate
from registry.contract.components import IN_MEMORY
from registry.contract.scene import PointCloud, Scene, View
from registry.discovery import Plugins
from registry.errors import PipelineError, SceneError
from registry.pipeline.edits import SECTIONS
from registry.pipeline.pipeline import Item, Pipeline, checked_pipeline
from registry.pipeline.ready import find_pipeline
from registry.pipeline.schedule import HostSettings
from registry.pipeline.yaml_source import Node, Place, parse, read, to_yaml
from registry.runs.folder import RunFolder
from registry.runs.options import RunOptions, find_device

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from core_rasterizer import Camera, Device, Engine, GaussianReader, Model
    from registry.runs.evaluation import Picture
    from registry.runs.run import Run

    from .quality.fitting import Fit

__all__ = [
    "build_pipeline",
    "load_scene",
    "open_run",
    "render",
    "results",
    "resume",
    "scene_from_arrays",
    "train",
]

PathLike = str | os.PathLike[str]
PipelineSource = Pipeline | Mapping[str, Any] | PathLike
"""A pipeline, or a source that `build_pipeline` accepts."""


def build_pipeline(
    source: Mapping[str, Any] | PathLike,
    overrides: Sequence[str] = (),
    disable: Sequence[str] = (),
    *,
    plugins: Plugins | None = None,
) -> Pipeline:
    """Return a checked pipeline. Without a `scene` it needs one in `train(pipeline, scene=...)`.

    Args:
        source: plain values like those of a pipeline file; the path of a pipeline file, or the name of a
            ready pipeline; or YAML text: a `str` with a line break or with "{" at its start.
        overrides: `a.b=value`, as for `--set`; applied before `disable`.
        disable: names of components to switch off, as for `--disable`.
        plugins: plugins that offer components; None: the installed ones.

    Raises:
        PipelineError: a mistake in the pipeline, with its line.
        PluginError: a component cannot be loaded.
    """
    root = _tree(source)
    changes_scene = any(text.strip().startswith("scene") for text in overrides)
    if isinstance(root.content, dict) and not changes_scene:
        written = root.content.get("scene")
        if written is None or written.content is None:
            root.content["scene"] = Node(IN_MEMORY, root.place)
    return checked_pipeline(root, plugins or Plugins(), overrides, disable)


def _tree(source: Mapping[str, Any] | PathLike) -> Node:
    if isinstance(source, Mapping):
        try:
            text = to_yaml(json.loads(json.dumps(source, default=os.fspath)))
        except (TypeError, ValueError) as error:
            raise PipelineError(
                f"a pipeline consists of plain values: {error}",
                where="the pipeline's values",
                fix="use dicts, lists, texts, numbers, True, False and None",
            ) from error
        return parse(text, "the pipeline's values", has_lines=False)
    if _is_text(source):
        return parse(str(source), "the pipeline's text")
    return read(find_pipeline(Path(source).expanduser()))


def _is_text(source: PathLike) -> bool:
    return isinstance(source, str) and ("\n" in source or source.lstrip().startswith("{"))


@one_torch_thread()
def load_scene(
    source: PipelineSource,
    changes: Sequence[str] = (),
    *,
    format_name: str | None = None,
    device: Device | Engine | str | None = None,
) -> Scene:
    """Load and validate the scene in a folder, or of a pipeline.

    Args:
        source: a folder of photographs or of a data set; or a pipeline, its file, text or values.
        changes: `key=value`, settings of the loader; not for a pipeline that is already built.
        format_name: the loader for a folder; None chooses the loader that recognizes the folder.
        device: as in `RunOptions`.

    Raises:
        ExplainedError: the path does not exist, no loader or several recognize the folder, or loading fails.
    """
    from .scene_source import FoundLoader, find_loader

    if isinstance(source, str | os.PathLike) and not _is_text(source):
        path = Path(source).expanduser()
        found = find_loader(path, Plugins(), format_name=format_name, changes=changes)
    else:
        if not isinstance(source, Pipeline):
            source = build_pipeline(source, [f"scene.{x.removeprefix('scene.')}" for x in changes])
        elif changes:
            fix = "give the changes to build_pipeline"
            raise PipelineError("the pipeline is already built", fix=fix)
        found = FoundLoader(source)
    return found.load(find_device(device))


def scene_from_arrays(
    images: Sequence[ArrayLike],
    cameras: Sequence[Camera],
    *,
    bounds: tuple[float, float],
    test: Sequence[int] = (),
    weights: Sequence[ArrayLike | float | None] | None = None,
    points: PointCloud | None = None,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    name: str = "scene",
) -> Scene:
    """Return a validated scene from photographs as arrays; views are named view_000, view_001, ...

    Args:
        images: each `[H, W, 3]`, uint8, or floating point in [0, 1].
        cameras: one for each image, of its size.
        test: indices of the test views; the others train.
        weights: one for each image, or None: `[H, W]` in [0, 1], 0 excludes a pixel from training and scores;
            or one number for all pixels, for example of a generated image.
        bounds, points, background, name: as in `registry.Scene`.

    Raises:
        SceneError: the numbers of cameras, weights and images differ, an index in `test` does not exist, or
            the scene is not valid (`registry.validate`).
    """
    if len(images) != len(cameras):
        what = f"{len(images)} images and {len(cameras)} cameras were given"
        raise SceneError(what, where=name, fix="give one camera for each image")
    if weights is None:
        weights = [None] * len(images)
    if len(images) != len(weights):
        what = f"{len(images)} images and {len(weights)} weights were given"
        raise SceneError(what, where=name, fix="give weights, or None, for each image")
    for index in test:
        if not 0 <= index < len(images):
            what = f"test has the index {index}, but there are {len(images)} images"
            raise SceneError(what, where=name, fix="count from 0")
    views = [
        View(f"view_{index:03d}", camera, _colors(image), weights=_weights(weight, camera))
        for index, (image, camera, weight) in enumerate(zip(images, cameras, weights, strict=True))
    ]
    train = tuple(view for index, view in enumerate(views) if index not in test)
    tested = tuple(views[index] for index in test)
    return validate(Scene(name, train, tested, bounds, points, background))


def _colors(image: ArrayLike) -> Any:
    """Return `[H, W, 3]` float32 in [0, 1]; `validate` refuses other shapes and values."""
    import numpy as np
    import torch

    array = np.asarray(image)
    scale = 255 if array.dtype == np.uint8 else 1
    return torch.from_numpy((array / np.float32(scale)).astype(np.float32))


def _weights(weight: ArrayLike | float | None, camera: Camera) -> Any:
    """Return `[H, W]` float32, or None."""
    import numpy as np
    import torch

    if weight is None:
        return None
    values = torch.from_numpy(np.asarray(weight, np.float32))
    return values.repeat(camera.height, camera.width) if values.ndim == 0 else values


def train(
    pipeline: PipelineSource,
    options: RunOptions | None = None,
    *,
    out: PathLike | Callable[[Pipeline, Scene], Path] | None = None,
    fit: Fit | None = None,
    **changes: Any,
) -> Run:
    """Train a pipeline.

    Args:
        pipeline: a pipeline, or any source that `build_pipeline` accepts.
        options: how the training runs.
        out: the run folder, new or empty, or a function that returns it; None writes nothing to disk.
        fit: chooses the size of photographs, the pipeline and its length (`within`).
        changes: single fields of `RunOptions`, for example `callback=` or `scene=`.

    Returns:
        The run; not `finished` if the callback or Ctrl-C stopped it.

    Raises:
        ExplainedError: an error in the pipeline, the scene or a component.
    """
    options = replace(options or RunOptions(), **changes)
    checked = pipeline if isinstance(pipeline, Pipeline) else build_pipeline(pipeline)
    if options.scene is not None:
        checked = _in_memory(checked, options.scene)
    elif checked.one("scene").offer.name == IN_MEMORY:
        raise SceneError(
            "the pipeline does not name a scene, and none is given",
            fix="give one, train(pipeline, scene=...), or write scene: {use: ..., path: ...}",
        )
    from registry.runs.training_run import start_run

    folder = Path(out).expanduser() if isinstance(out, str | os.PathLike) else out
    return (start_run if fit is None else fit.train)(checked, options, folder)


def _in_memory(pipeline: Pipeline, scene: Scene) -> Pipeline:
    """Return the pipeline with a scene that is given."""
    if pipeline.protocol is not None:
        name = pipeline.protocol.protocol.name
        what = f"the protocol {name!r} does not apply to a scene that is given"
        fix = 'remove it: build_pipeline(..., ["protocol=null"])'
        raise SceneError(what, where=scene.name, fix=fix)
    offer = Plugins(()).find(SECTIONS["scene"], IN_MEMORY)
    place = Place("the scene that is given")
    item = Item(IN_MEMORY, offer.settings_type(), HostSettings(use=IN_MEMORY), offer, place)
    return replace(pipeline, items={**pipeline.items, "scene": (item,)})


def resume(folder: PathLike, options: RunOptions | None = None, **changes: Any) -> Run:
    """Continue a run that was stopped, to the same result as if it had not been.

    Args:
        folder: the run folder.
        options, changes: as for `train`.

    Raises:
        ExplainedError: the folder is not a run or has no checkpoint, or an error as in `train`.
    """
    path = RunFolder.existing(Path(folder).expanduser()).path
    from registry.runs.training_run import continue_run

    return continue_run(path, replace(options or RunOptions(), **changes), Plugins())


def open_run(
    folder: PathLike,
    *,
    scene: Scene | PathLike | None = None,
    device: Device | Engine | str | None = None,
    accept_changed_inputs: bool = False,
    photographs: bool = True,
) -> Run:
    """Read a run folder: its pipeline, scene and Gaussians.

    Components that cannot be loaded are left out (`run.pipeline.missing`), except the scene's loader.

    Args:
        folder: the run folder.
        scene: needed if the run was trained on a scene made in Python; or the folder of moved data.
        photographs: False accepts a scene without images, if its data cannot be loaded.
        device, accept_changed_inputs: as in `RunOptions`.

    Raises:
        ExplainedError: the folder is not a run, or a part of it cannot be read.
    """
    path = RunFolder.existing(Path(folder).expanduser()).path
    from registry.runs.opening import load_run

    with one_torch_thread():
        return load_run(
            path,
            plugins=Plugins(),
            device=find_device(device),
            scene=Path(scene).expanduser() if isinstance(scene, str | os.PathLike) else scene,
            accept_changed_inputs=accept_changed_inputs,
            to_train=False,
            photographs=photographs,
        )


def results(folder: PathLike) -> dict[str, Any]:
    """Return the content of results.json in a run folder, empty before the run has ended.

    Raises:
        RunError: the folder is not a run, or the file is damaged.
    """
    return RunFolder.existing(Path(folder).expanduser()).results()


def render(
    source: Run | GaussianReader | Model,
    camera: Camera,
    *,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Picture:
    """Render a camera as numpy arrays: rgb `[H, W, 3]` in [0, 1], depth and alpha `[H, W]`.

    Args:
        source: a run, rendered on its own background, or Gaussians; `Run.model` too takes cameras of the
            scene's files.
        background: colour behind Gaussians, three numbers in [0, 1].
    """
    from core_rasterizer import GaussianReader
    from registry.runs.evaluation import as_arrays
    from registry.runs.run import Run

    if isinstance(source, Run):
        return source.render(camera)
    reader = source if isinstance(source, GaussianReader) else GaussianReader(source)
    return as_arrays(reader.render(camera, background=background))
