"""The sparse-view protocols as NerfBaselines datasets: `--data external://stereogs-llff-3/fern`.

Instead of a download, datasets are made from the folders in STEREOGS_DATA by the project's loaders, so that
every NerfBaselines method gets the pixels, cameras and split of `protocol: llff-3`. A prepared folder has

    images/, masks/    PNG
    views.json         cameras, split and depth bounds
    nb-info.json       metadata for NerfBaselines
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
from nerfbaselines import DatasetNotFoundError, UnloadedDataset, new_cameras, new_dataset

import stereogs
from registry.pipeline import Pipeline, load_protocol
from registry.system import write_text
from registry.toolkit.drawing import save_png

DATA = "STEREOGS_DATA"
PREFIX = "stereogs-"
"""Prefix of a protocol's name in the dataset's name."""
LOADER = "stereogs-views"
EVALUATION = "stereogs"
_VIEWS = "views.json"


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
        _write(stereogs.load_scene(pipeline_of(name, _folder(scene))), name, scene, Path(output))
        return
    for one in load_protocol(name).scenes:
        try:
            folder = _folder(one)
        except DatasetNotFoundError:
            continue
        _write(stereogs.load_scene(pipeline_of(name, folder)), name, one, Path(output) / one)


def pipeline_of(protocol: str, folder: Path | None = None) -> Pipeline:
    """Build a pipeline of a protocol, for its scene and its metrics.

    Args:
        folder: folder of the scene; None if only the metrics are used.
    """
    loaders = load_protocol(protocol).loaders
    known = [name for name in loaders if folder is None or _reads(name, folder)]
    if not known:
        raise DatasetNotFoundError(f"{folder} does not have the layout of {' or '.join(loaders)}")
    return stereogs.build_pipeline(
        {
            "name": protocol,
            "protocol": protocol,
            "scene": {"use": known[0], "path": str(folder or "none")},
            "initializer": "random",
        }
    )


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


def _reads(loader: str, folder: Path) -> bool:
    from registry.plugins import Plugins, scene_loaders

    return any(
        offer.name == loader and component.recognizes(folder)
        for offer, component in scene_loaders(Plugins())
    )


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
