"""A scene from a folder, a pipeline, or arrays."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..contract.checks.scene import validate
from ..contract.scene import PointCloud, Scene, View
from ..errors import PipelineError, SceneError
from ..pipeline.pipeline import Pipeline
from ..plugins.discovery import Plugins
from .arguments import device_of
from .pipelines import PipelineSource, build_pipeline, is_text

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from core_rasterizer import Camera, Device

    from ..inspection.scene_source import FoundLoader


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
    from ..inspection.scene_source import load
    from ..training.threads import one_torch_thread

    with one_torch_thread():
        return load(found, device_of(device))


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


def _loader(source: PipelineSource, changes: Sequence[str], format_name: str | None) -> FoundLoader:
    from ..inspection.scene_source import FoundLoader, find_loader

    if isinstance(source, str | os.PathLike) and not is_text(source):
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


def _colors(image: ArrayLike) -> Any:
    """`[H, W, 3]` float32 in [0, 1]; what is no such image is left for `validate` to refuse."""
    import numpy as np
    import torch

    array = np.asarray(image)
    scale = 255 if array.dtype == np.uint8 else 1
    return torch.from_numpy((array / np.float32(scale)).astype(np.float32))
