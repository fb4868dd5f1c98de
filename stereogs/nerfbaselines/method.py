"""Pipelines as a method of NerfBaselines (Kulhanek and Sattler 2024), a common evaluation of methods.

Available once both packages are installed: `nerfbaselines train --method stereogs --data FOLDER`. One
NerfBaselines iteration is a complete training, since the pipeline defines the number of iterations.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from nerfbaselines import Cameras, Dataset, Method, MethodInfo, ModelInfo, RenderOptions

import stereogs
from core_rasterizer import Model, OpenCLEngine, load_ply
from registry import Frame, SceneError
from registry.training.placed import PlacedGaussians

PIPELINE = "weightfree_fast"
"""The default of the setting `pipeline`."""

GAUSSIANS, SETTINGS = "scene.ply", "stereogs.json"
BLACK = (0.0, 0.0, 0.0)


class StereoGS(Method):  # type: ignore[misc]  # typed only if nerfbaselines is installed
    """A pipeline, trained on a NerfBaselines dataset or loaded from a checkpoint.

    Args:
        checkpoint: a folder written by `save`.
        train_dataset: photographs in sRGB with pinhole cameras. Depth bounds come from `nears_fars`, or
            from the dataset's points; the points are not used for training, since they also come from
            test photographs.
        config_overrides: `pipeline`, the name of a ready pipeline or a file, and any of its settings by
            their dotted names, `{"training.iterations": 100}`.
    """

    def __init__(
        self,
        *,
        checkpoint: str | None = None,
        train_dataset: Dataset | None = None,
        config_overrides: dict[str, Any] | None = None,
    ) -> None:
        self._checkpoint = checkpoint
        self._dataset = train_dataset
        self._model: Model | None = None
        self._frame = Frame()
        self._background = BLACK
        self._settings = dict(config_overrides or {})
        if checkpoint is not None:
            self._read(Path(checkpoint))
        elif train_dataset is not None:
            self._background = _background(train_dataset)

    @classmethod
    def get_method_info(cls) -> MethodInfo:
        """Return the required features of datasets, and the supported cameras and outputs."""
        return MethodInfo(
            method_id="stereogs",
            required_features=frozenset(("color", "points3D_xyz")),
            supported_camera_models=frozenset(("pinhole",)),
            supported_outputs=("color", "depth", "accumulation"),
            can_resume_training=False,
        )

    def get_info(self) -> ModelInfo:
        """Return the method's info with the settings and the loaded checkpoint."""
        return ModelInfo(
            **self.get_method_info(),
            num_iterations=1,
            loaded_step=None if self._model is None or self._checkpoint is None else 1,
            loaded_checkpoint=self._checkpoint,
            hparams={"pipeline": PIPELINE} | self._settings,
        )

    def train_iteration(self, step: int) -> dict[str, float]:
        """Train the whole pipeline; return the last loss and the number of Gaussians.

        Raises:
            ExplainedError: the dataset or the pipeline is invalid.
        """
        if self._dataset is None:
            raise SceneError("no dataset to train on", fix="pass a train_dataset")
        settings = dict(self._settings)
        source = Path(settings.pop("pipeline", PIPELINE))
        changes = [f"{name}={_written(value)}" for name, value in settings.items()]
        pipeline = stereogs.build_pipeline(source, ["scene=in_memory", *changes])
        losses: list[float] = []
        run = stereogs.train(
            pipeline,
            scene=_scene_of(self._dataset, self._background),
            callback=lambda done: losses.append(done.loss),
        )
        self._model, self._frame = run.engine_model, run.frame
        return {"loss": losses[-1], "num_gaussians": float(run.model.count)}

    def render(self, camera: Cameras, *, options: RenderOptions | None = None) -> dict[str, Any]:
        """Return `color` `[H, W, 3]` in [0, 1], z-`depth` in world units and `accumulation` `[H, W]`."""
        if self._model is None:
            raise SceneError("no Gaussians to render", fix="train, or load a checkpoint")
        picture = stereogs.render(
            PlacedGaussians(self._model, self._frame),
            _camera_of(camera.item()),
            background=self._background,
        )
        answer = {"color": picture.rgb, "depth": picture.depth, "accumulation": picture.alpha}
        wanted = (options or {}).get("outputs", tuple(answer))
        return {name: values for name, values in answer.items() if name in wanted}

    def save(self, path: str) -> None:
        """Write the settings and, after training, the Gaussians as a PLY file in the frame of training."""
        from core_rasterizer import save_ply

        folder = Path(path)
        folder.mkdir(parents=True, exist_ok=True)
        frame = asdict(self._frame)
        content = {"settings": self._settings, "background": self._background, "frame": frame}
        (folder / SETTINGS).write_text(json.dumps(content, indent=2), "utf-8")
        if self._model is not None:
            save_ply(self._model.gaussians(), folder / GAUSSIANS)

    def _read(self, folder: Path) -> None:
        content = json.loads((folder / SETTINGS).read_text("utf-8"))
        self._settings = content["settings"] | self._settings
        self._background = tuple(content["background"])
        frame = content.get("frame")  # older checkpoints have the file's coordinates
        self._frame = Frame(tuple(frame["center"]), frame["unit"]) if frame else Frame()
        if (folder / GAUSSIANS).is_file():
            self._model = OpenCLEngine(stereogs.open_device()).model(load_ply(folder / GAUSSIANS))


def _written(value: Any) -> str:
    """Format a setting for --set; NerfBaselines passes the values of its own --set as text."""
    return value if isinstance(value, str) else json.dumps(value)


def _background(dataset: Dataset) -> tuple[float, float, float]:
    """Return the dataset's background colour, which it stores as bytes; black by default."""
    color = dataset["metadata"].get("background_color")
    if color is None:
        return BLACK
    red, green, blue = (float(channel) / 255 for channel in color)
    return red, green, blue


def _scene_of(dataset: Dataset, background: tuple[float, float, float]) -> stereogs.Scene:
    cameras = [_camera_of(camera) for camera in dataset["cameras"]]
    images = [_opaque(np.asarray(image), background) for image in dataset["images"]]
    bounds = _bounds(dataset, cameras)
    return stereogs.scene_from_arrays(images, cameras, bounds=bounds, background=background)


def _opaque(image: np.ndarray[Any, Any], background: tuple[float, float, float]) -> Any:
    """Composite a photograph with alpha on the background, `[H, W, 3]`; return others unchanged."""
    if image.shape[2] == 3:
        return image
    scaled = image.astype(np.float32) / (255 if image.dtype == np.uint8 else 1)
    alpha = scaled[..., 3:]
    behind = np.asarray(background, np.float32)
    return scaled[..., :3] * alpha + behind * (1 - alpha)


def _camera_of(camera: Cameras) -> stereogs.Camera:
    """Convert a camera; NerfBaselines poses are camera to world, with OpenCV's axes."""
    pose = np.eye(4)
    pose[:3] = camera.poses[:3]
    fx, fy, cx, cy = (float(value) for value in camera.intrinsics)
    width, height = (int(value) for value in camera.image_sizes)
    return stereogs.Camera(torch.from_numpy(np.linalg.inv(pose)), fx, fy, cx, cy, width, height)


def _bounds(dataset: Dataset, cameras: list[stereogs.Camera]) -> tuple[float, float]:
    """Return the nearest and farthest depth of all cameras, or of the points."""
    limits = dataset["cameras"].nears_fars
    if limits is not None:
        return float(limits.min()), float(limits.max())
    points = dataset["points3D_xyz"]
    if points is None or not len(points):
        raise SceneError(
            "the depth bounds are unknown",
            fix="use a dataset whose cameras have nears_fars, or that has points",
        )
    positions = torch.from_numpy(np.asarray(points, np.float64))
    depths = torch.cat([camera.project(positions)[2] for camera in cameras])
    inside = depths[depths > 0].double()
    return float(inside.quantile(0.01)), float(inside.quantile(0.99))
