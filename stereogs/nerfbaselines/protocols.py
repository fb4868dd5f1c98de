"""The sparse-view protocols in NerfBaselines: datasets and evaluation, `--data external://stereogs-llff-3/fern`.

Datasets are not downloaded but made from the folders in STEREOGS_DATA by the project's loaders, so that every
NerfBaselines method gets the pixels, cameras and split of `protocol: llff-3`. A prepared folder has

    images/, masks/    PNG
    views.json         cameras, split and depth bounds
    nb-info.json       metadata for NerfBaselines
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from nerfbaselines import (
    Dataset,
    DatasetNotFoundError,
    UnloadedDataset,
    new_cameras,
    new_dataset,
)
from nerfbaselines.evaluation import DefaultEvaluationProtocol

import stereogs
from registry import Metric, SceneError, Unavailable
from registry.pipeline.parts import build_part
from registry.pipeline.protocols import load_protocol
from registry.system.files import write_text
from registry.toolkit.drawing import save_png

from ..protocol_scene import pipeline_of

DATA = "STEREOGS_DATA"
PREFIX = "stereogs-"
"""Prefix of a protocol's name in the dataset's name."""
LOADER = "stereogs-views"
EVALUATION = "stereogs"
_VIEWS = "views.json"

Scores = dict[str, float | int]


def prepare(path: str, output: str | Path) -> None:
    """Make a dataset, instead of a download.

    Args:
        path: `stereogs-PROTOCOL/SCENE`, or `stereogs-PROTOCOL` for all available scenes of the protocol.
            A scene is a folder in STEREOGS_DATA with that name, or whose name ends in `_SCENE`.
        output: a new folder; for several scenes, the parent of their folders.

    Raises:
        DatasetNotFoundError: the name is invalid, or the scene is not found.
        ExplainedError: its folder cannot be read.
    """
    dataset, _, scene = path.partition("/")
    name = dataset.removeprefix(PREFIX)
    if scene:
        _write(_scene(name, _folder(scene)), name, scene, Path(output))
        return
    for each in load_protocol(name).scenes:
        try:
            folder = _folder(each)
        except DatasetNotFoundError:
            continue
        _write(_scene(name, folder), name, each, Path(output) / each)


def load(path: str, split: str, features: Any = None, **_: Any) -> UnloadedDataset:
    """Load a prepared folder; NerfBaselines reads the images.

    Args:
        split: "train" or "test".

    Raises:
        DatasetNotFoundError: the folder was not made by `prepare`.
    """
    folder = Path(path)
    if not (folder / _VIEWS).is_file():
        raise DatasetNotFoundError(f"{folder} does not contain {_VIEWS}")
    content = json.loads((folder / _VIEWS).read_text("utf-8"))
    views = content[split]
    masks = [str(folder / "masks" / f"{view['name']}.png") for view in views]
    return new_dataset(
        cameras=new_cameras(
            poses=np.array([view["pose"] for view in views], np.float32),
            intrinsics=np.array([view["intrinsics"] for view in views], np.float32),
            camera_models=np.zeros(len(views), np.int32),
            image_sizes=np.array([view["size"] for view in views], np.int32),
            nears_fars=np.array([content["bounds"]] * len(views), np.float32),
        ),
        image_paths=[str(folder / "images" / f"{view['name']}.png") for view in views],
        image_paths_root=str(folder / "images"),
        mask_paths=masks if all(Path(mask).is_file() for mask in masks) else None,
        mask_paths_root=str(folder / "masks"),
        points3D_xyz=None,
        points3D_rgb=None,
        metadata={
            "color_space": "srgb",
            "evaluation_protocol": EVALUATION,
            "background_color": np.array(content["background"], np.uint8),
        },
    )


def _folder(scene: str) -> Path:
    root = os.environ.get(DATA)
    if not root or not Path(root).is_dir():
        raise DatasetNotFoundError(f"set {DATA} to the folder of the data sets")
    for folder in sorted(Path(root).iterdir()):
        if folder.is_dir() and (folder.name == scene or folder.name.endswith(f"_{scene}")):
            return folder
    raise DatasetNotFoundError(
        f"{root} has no folder that is named {scene!r} or ends in '_{scene}'"
    )


def _scene(protocol: str, folder: Path) -> stereogs.Scene:
    try:
        pipeline = pipeline_of(protocol, folder)
    except SceneError as error:  # another layout
        raise DatasetNotFoundError(str(error)) from error
    return stereogs.load_scene(pipeline)


def _write(scene: stereogs.Scene, protocol: str, name: str, folder: Path) -> None:
    for part in ("images", "masks"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    for view in (*scene.train, *scene.test):
        save_png(view.image, folder / "images" / f"{view.name}.png")
        if view.mask is not None:
            mask = view.mask[..., None].expand(-1, -1, 3).float()
            save_png(mask, folder / "masks" / f"{view.name}.png")
    views = {
        "train": [_described(view) for view in scene.train],
        "test": [_described(view) for view in scene.test],
        "bounds": scene.bounds,
        "background": [round(255 * channel) for channel in scene.background],
    }
    write_text(folder / _VIEWS, json.dumps(views, indent=1))
    information = {
        "id": f"{PREFIX}{protocol}",
        "scene": name,
        "loader": LOADER,
        "evaluation_protocol": EVALUATION,
    }
    write_text(folder / "nb-info.json", json.dumps(information, indent=1))


def _described(view: stereogs.View) -> dict[str, Any]:
    """Return a NerfBaselines camera: camera to world `[3, 4]`, OpenCV's axes."""
    camera = view.camera
    return {
        "name": view.name,
        "pose": camera.camera_to_world[:3].tolist(),
        "intrinsics": [camera.fx, camera.fy, camera.cx, camera.cy],
        "size": [camera.width, camera.height],
    }


class ProtocolScores(DefaultEvaluationProtocol):  # type: ignore[misc]  # see nerfbaselines_method
    """The protocol's metrics with their settings and masks; means over the views.

    Unavailable metrics (`lpips` without its network's file) are omitted.
    """

    def get_name(self) -> str:
        """Return the name used in results."""
        return EVALUATION

    def evaluate(self, predictions: dict[str, Any], dataset: Dataset) -> Scores:
        """Return the scores of one view.

        Args:
            predictions: `color` `[H, W, 3]`, bytes or in [0, 1].
            dataset: a dataset made by `prepare`, reduced to this view.
        """
        rendered, photograph = (_image(x) for x in (predictions["color"], dataset["images"][0]))
        masks = dataset.get("masks")
        mask = None if masks is None else torch.from_numpy(np.asarray(masks[0]) > 0)
        scores: Scores = {}
        for name, metric in _metrics(dataset["metadata"]["id"].removeprefix(PREFIX)).items():
            score = metric.measure(rendered, photograph, mask)
            if not isinstance(score, Unavailable):
                scores[name] = score
        return scores

    def accumulate_metrics(self, metrics: Iterable[Scores]) -> Scores:
        """Return the mean of each metric."""
        rows = list(metrics)
        return {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}


@cache
def _metrics(protocol: str) -> dict[str, Metric[Any]]:
    pipeline = pipeline_of(protocol)
    device = stereogs.open_device()
    parts = (build_part(i, pipeline.training.seed, device) for i in pipeline.items["metrics"])
    return {part.item.name: part.component for part in parts}


def _image(values: Any) -> torch.Tensor:
    array = np.asarray(values)[..., :3]
    scale = 255 if array.dtype == np.uint8 else 1
    return torch.from_numpy(array.astype(np.float32) / scale).clamp(0, 1)
