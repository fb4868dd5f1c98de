"""The Gaussians to view, with their cameras and photographs, and the initial pose of the viewer."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
from pydantic import BaseModel, Field, RootModel
from torch import Tensor

from core_rasterizer import Camera, Device, ExplainedError, Gaussians, Model, OpenCLEngine, load_ply
from registry import Scene
from registry.confidence import Confidence
from registry.contract.frame import Frame
from registry.contract.scene import camera_extent
from registry.runs.results import EXPORTS
from registry.runs.run import Run
from registry.toolkit.drawing import upwards
from registry.toolkit.drawing.camera_path import Vector
from registry.toolkit.photos import Finite, read_document
from registry.training.initial_model import new_model

from .edited_run import save_edited
from .edits import Source
from .reach import Reach

_DEFAULT_UP = (0.0, -1.0, 0.0)
"""In most scenes of COLMAP and 3DGS the y axis points down."""
_DISTANCE = 2.5
"""Distance from the center of Gaussians without cameras, in units of their spread."""
_EXTENT_OF_ONE = 0.1
"""Extent of cameras at one position, in units of the depth that one sees."""
_DEFAULT_DEPTH = 5.0
"""Distance of the orbit point if the camera sees nothing, in units of the extent."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Viewpoint:
    """A camera of the scene.

    Args:
        name: of the view.
        camera: intrinsics and pose.
        photograph: `[H, W, 3]` in [0, 1]; None if unknown.
        is_test: True for a test view.
    """

    name: str
    camera: Camera
    photograph: Tensor | None = None
    is_test: bool = False


@dataclass(frozen=True, eq=False)
class Subject:
    """Gaussians to view.

    Args:
        name: title of the page.
        model: the Gaussians.
        viewpoints: training views, then test views; empty for a PLY file without cameras.
        background: color in [0, 1].
        kinds: mask `[N]` bool of the Gaussians that descend from each kind of initial points.
        confidence: returns the confidence in renders, estimated on the first call; None if unknown.
        source: where edited Gaussians are saved; None if these cannot be edited.
    """

    name: str
    model: Model
    viewpoints: tuple[Viewpoint, ...] = ()
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    kinds: Mapping[str, Tensor] = field(default_factory=dict)
    confidence: Callable[[], Confidence] | None = None
    source: Source | None = None


def of_run(run: Run) -> Subject:
    """Return the Gaussians of a run, not copied, with their confidence."""
    confidence = cache(lambda: run.trained.confidence("calibrated"))
    subject, source = _of(run, run.engine_model, run.kinds), None
    if run.folder is not None:
        path, exported = run.folder.lasting / EXPORTS / "scene.ply", run.exported
        save_run = partial(save_edited, run)
        source = Source(path, exported.gaussians, exported.attributes, save_run)
    return replace(subject, confidence=confidence if run.photographs else None, source=source)


def snapshot(run: Run) -> Subject:
    """Return a copy of the Gaussians of a run.

    Raises:
        GaussianError: a Gaussian is not finite; training removes such Gaussians.
    """
    kept = run.checkpoint()
    gaussians = Gaussians(**kept.part("model"))
    model = new_model(gaussians, run.pipeline.training, run.engine_model.engine)
    return _of(run, model, kept.part("kinds"))


def of_file(path: Path, device: Device) -> Subject:
    """Return the Gaussians of a PLY file, with the cameras of a `cameras.json` next to it, if any.

    Raises:
        PlyError: it cannot be read, or holds no Gaussians.
    """
    gaussians = load_ply(path)
    frame = Frame.around(gaussians)
    viewpoints = tuple(
        Viewpoint(name, frame.camera_of_file(camera)) for name, camera in _cameras_of(path)
    )
    model = OpenCLEngine(device).model(frame.gaussians_of_file(gaussians))
    return Subject(path.name, model, viewpoints, source=Source(path, lambda: gaussians, {}))


def _of(run: Run, model: Model, kinds: Mapping[str, Tensor]) -> Subject:
    title = f"{run.scene.name}, {run.pipeline.name}"
    viewpoints = viewpoints_of(run.framed)
    if not run.photographs:
        viewpoints = tuple(replace(point, photograph=None) for point in viewpoints)
    return Subject(title, model, viewpoints, run.scene.background, kinds)


def viewpoints_of(scene: Scene) -> tuple[Viewpoint, ...]:
    """Return the training views, then the test views."""
    return (
        *(Viewpoint(view.name, view.camera, view.image) for view in scene.train),
        *(Viewpoint(view.name, view.camera, view.image, is_test=True) for view in scene.test),
    )


_Vector = tuple[Finite, Finite, Finite]
_Pixels = Annotated[int, Field(gt=0, le=65_535)]
_FocalLength = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class _ListedCamera(BaseModel):
    """A camera in `cameras.json` of the 3DGS code; the columns of `rotation` are its axes in the world."""

    img_name: str
    width: _Pixels
    height: _Pixels
    position: _Vector
    rotation: tuple[_Vector, _Vector, _Vector]
    fx: _FocalLength
    fy: _FocalLength

    def camera(self) -> Camera:
        """Return the camera; its principal point, which the format lacks, is the image center."""
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = self.rotation, self.position
        center = self.width / 2, self.height / 2
        world_to_camera = torch.from_numpy(np.linalg.inv(pose))
        return Camera(world_to_camera, self.fx, self.fy, *center, self.width, self.height)


_CameraList = RootModel[list[_ListedCamera]]


def _cameras_of(ply: Path) -> list[tuple[str, Camera]]:
    """Return the names and cameras in `cameras.json`; logs a warning if it cannot be read."""
    file = ply.with_name("cameras.json")
    if not file.is_file():
        return []
    try:
        listed = read_document(file, _CameraList, "export it again, or remove it").root
        return [(camera.img_name, camera.camera()) for camera in listed]
    except (ExplainedError, np.linalg.LinAlgError) as error:
        what = error.what if isinstance(error, ExplainedError) else str(error)
        _log.warning("the cameras are not shown: %s (%s)", what, file)
        return []


@dataclass(frozen=True, eq=False)
class StartPose:
    """A camera pose; vectors are `[3]` in world units.

    Args:
        field_of_view: vertical, radians.
        extent: of the scene's cameras, world units, > 0.
        reach: where the camera is near the training views; None without any.
    """

    position: Vector
    look_at: Vector
    up: Vector
    field_of_view: float
    extent: float
    reach: Reach | None = None

    @property
    def distance(self) -> float:
        """Distance from `position` to `look_at`, world units, > 0."""
        return max(float(np.linalg.norm(self.look_at - self.position)), 1e-6)


def start_pose(subject: Subject) -> StartPose:
    """Return the pose of the central training camera, upright; without cameras, one that sees everything."""
    means = subject.model.read("means").double()
    cameras = [point.camera for point in subject.viewpoints if not point.is_test]
    if not cameras:
        center = means.median(dim=0).values
        spread = float((means - center).norm(dim=1).median())
        offset = torch.tensor([0.0, 0.0, -_DISTANCE * spread], dtype=torch.float64)
        up = np.asarray(_DEFAULT_UP)
        return StartPose((center + offset).numpy(), center.numpy(), up, np.pi / 3, spread)
    extent = camera_extent(cameras)
    depths = [_depth(camera, means, extent) for camera in cameras]
    index = _central(cameras)
    camera, depth = cameras[index], depths[index]
    extent = extent if extent > 1e-6 * depth else _EXTENT_OF_ONE * depth
    origin, forward = camera.center.numpy(), camera.world_to_camera[2, :3].numpy()
    field_of_view = float(2 * np.arctan(0.5 * camera.height / camera.fy))
    look_at, up = origin + depth * forward, upwards(cameras)
    return StartPose(origin, look_at, up, field_of_view, extent, Reach(cameras, depths))


def _central(cameras: Sequence[Camera]) -> int:
    """Return the index of the camera nearest to the middle of all."""
    centers = torch.stack([camera.center for camera in cameras])
    return int((centers - centers.mean(dim=0)).norm(dim=1).argmin())


def _depth(camera: Camera, means: Tensor, extent: float) -> float:
    """Return the median z-depth that a camera sees, world units, > 0."""
    u, v, z = camera.project(means)
    seen = z[camera.contains(u, v, z)]
    return float(seen.median()) if len(seen) else _DEFAULT_DEPTH * max(extent, 1e-6)
