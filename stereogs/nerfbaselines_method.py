"""Any pipeline as a method of NerfBaselines (Kulhanek and Sattler 2024), which evaluates all methods alike.

NerfBaselines finds it once both are installed: `nerfbaselines train --method stereogs --data FOLDER`. What
it calls an iteration is a whole training here, because a pipeline says itself how many it takes.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import torch
from nerfbaselines import Cameras, Dataset, Method, MethodInfo, ModelInfo, RenderOptions

import stereogs
from core_rasterizer import GaussianModel, load_ply
from registry import SceneError

PIPELINE = "weightfree_fast"
"""The ready pipeline that is trained unless the setting `pipeline` names another."""

GAUSSIANS, SETTINGS = "scene.ply", "stereogs.json"
BLACK = (0.0, 0.0, 0.0)


class StereoGS(Method):  # type: ignore[misc]  # its types are known where it is installed
    """A pipeline, trained on a dataset of NerfBaselines or read from a checkpoint.

    Args:
        checkpoint: a folder that `save` wrote.
        train_dataset: photographs in sRGB with pinhole cameras. Depth bounds come from `nears_fars`, or
            from the dataset's points where it has some; the points are not trained on, since they
            come from test photographs too.
        config_overrides: `pipeline`, a ready pipeline's name or a file, and any of its settings by
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
        self._model: GaussianModel | None = None
        self._background = BLACK
        self._settings = dict(config_overrides or {})
        if checkpoint is not None:
            self._read(Path(checkpoint))
        elif train_dataset is not None:
            self._background = _background(train_dataset)

    @classmethod
    def get_method_info(cls) -> MethodInfo:
        """What datasets must bring, and what can be rendered."""
        return MethodInfo(
            method_id="stereogs",
            required_features=frozenset(("color", "points3D_xyz")),
            supported_camera_models=frozenset(("pinhole",)),
            supported_outputs=("color", "depth", "accumulation"),
            can_resume_training=False,
        )

    def get_info(self) -> ModelInfo:
        """The same, with the settings and whether a checkpoint was read."""
        return ModelInfo(
            **self.get_method_info(),
            num_iterations=1,
            loaded_step=None if self._model is None or self._checkpoint is None else 1,
            loaded_checkpoint=self._checkpoint,
            hparams={"pipeline": PIPELINE} | self._settings,
        )

    def train_iteration(self, step: int) -> dict[str, float]:
        """Train the whole pipeline; returns the last loss and the number of Gaussians.

        Raises:
            ExplainedError: the dataset cannot be trained on, or whatever the pipeline says.
        """
        if self._dataset is None:
            raise SceneError("there is nothing to train on", fix="give a train_dataset")
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
        self._model = run.model
        return {"loss": losses[-1], "num_gaussians": float(run.model.count)}

    def render(self, camera: Cameras, *, options: RenderOptions | None = None) -> dict[str, Any]:
        """`color` `[H, W, 3]` in [0, 1], z-`depth` in world units and `accumulation` `[H, W]`."""
        if self._model is None:
            raise SceneError("there are no Gaussians to render", fix="train, or read a checkpoint")
        picture = stereogs.render(
            self._model, _camera_of(camera.item()), background=self._background
        )
        answer = {"color": picture.rgb, "depth": picture.depth, "accumulation": picture.alpha}
        wanted = (options or {}).get("outputs", tuple(answer))
        return {name: values for name, values in answer.items() if name in wanted}

    def save(self, path: str) -> None:
        """Write the settings and, once there are some, the Gaussians as a PLY file."""
        from core_rasterizer import save_ply

        folder = Path(path)
        folder.mkdir(parents=True, exist_ok=True)
        content = {"settings": self._settings, "background": self._background}
        (folder / SETTINGS).write_text(json.dumps(content, indent=2), "utf-8")
        if self._model is not None:
            save_ply(self._model.gaussians(), folder / GAUSSIANS)

    def _read(self, folder: Path) -> None:
        content = json.loads((folder / SETTINGS).read_text("utf-8"))
        self._settings = content["settings"] | self._settings
        self._background = tuple(content["background"])
        if (folder / GAUSSIANS).is_file():
            self._model = GaussianModel(load_ply(folder / GAUSSIANS), stereogs.open_device())


def _written(value: Any) -> str:
    """A setting as --set takes it; NerfBaselines' own --set hands on texts as they were typed."""
    return value if isinstance(value, str) else json.dumps(value)


def _background(dataset: Dataset) -> tuple[float, float, float]:
    """The colour that the dataset names, given there as bytes; black if none."""
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
    """A transparent photograph laid on the background, `[H, W, 3]`; others as they are."""
    if image.shape[2] == 3:
        return image
    scaled = image.astype(np.float32) / (255 if image.dtype == np.uint8 else 1)
    alpha = scaled[..., 3:]
    behind = np.asarray(background, np.float32)
    return scaled[..., :3] * alpha + behind * (1 - alpha)


def _camera_of(camera: Cameras) -> stereogs.Camera:
    """Poses there are camera to world, with OpenCV's axes."""
    pose = np.eye(4)
    pose[:3] = camera.poses[:3]
    fx, fy, cx, cy = (float(value) for value in camera.intrinsics)
    width, height = (int(value) for value in camera.image_sizes)
    return stereogs.Camera(torch.from_numpy(np.linalg.inv(pose)), fx, fy, cx, cy, width, height)


def _bounds(dataset: Dataset, cameras: list[stereogs.Camera]) -> tuple[float, float]:
    """The nearest and the farthest depth that any camera names, or that the points have."""
    limits = dataset["cameras"].nears_fars
    if limits is not None:
        return float(limits.min()), float(limits.max())
    points = dataset["points3D_xyz"]
    if points is None or not len(points):
        raise SceneError(
            "how near and far things are is not known",
            fix="use a dataset whose cameras have nears_fars, or that has points",
        )
    positions = torch.from_numpy(np.asarray(points, np.float32))
    depths = torch.cat([camera.project(positions)[2] for camera in cameras])
    inside = depths[depths > 0].double()
    return float(inside.quantile(0.01)), float(inside.quantile(0.99))
