"""Candidates that the user gives: poses in a file, or pictures of the scene."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import torch
from pydantic import BaseModel, Field

from registry import RunError
from registry.toolkit.photos import PoseMatrix, pose_from_opengl, read_document

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from torch import Tensor

    from core_rasterizer import Camera
    from registry.runs.run import Run

_FIX = 'write {"frames": [{"transform_matrix": [[4 numbers], [4], [4], [4]]}, ...]}'
_SAME = 1e-3
"""Largest difference of a pose that is loaded again: of its rotation, and of its place in scene extents."""


class _Frame(BaseModel):
    transform_matrix: PoseMatrix
    file_path: str | None = None


class _Poses(BaseModel):
    frames: list[_Frame] = Field(min_length=1)


def read_poses(file: Path, lens: Camera) -> tuple[list[str], list[Camera]]:
    """Return the names and cameras of a file; the lens is that of a photograph.

    Raises:
        SceneError: the file cannot be read, or a matrix is not a pose.
    """
    frames = read_document(file, _Poses, _FIX).frames
    names = [frame.file_path or f"pose {number}" for number, frame in enumerate(frames, start=1)]
    cameras = [
        replace(lens, world_to_camera=_pose(frame.transform_matrix, f"{file}: {name}"))
        for name, frame in zip(names, frames, strict=True)
    ]
    return names, cameras


def _pose(matrix: PoseMatrix, where: str) -> Tensor:
    return torch.from_numpy(pose_from_opengl(matrix, where))


def other_pictures(run: Run, settings: Sequence[str]) -> tuple[list[str], list[Camera]]:
    """Return the names and cameras of pictures that a run did not train on.

    Args:
        settings: `key=value`, settings of the scene's loader; without any, the test views.

    Raises:
        ExplainedError: the loader refuses the settings, or places the run's own cameras elsewhere with them.
    """
    from ...session import build_pipeline, load_scene

    views = run.scene.test
    trained = {view.name: view.camera for view in run.scene.train}
    if settings:
        changes = [f"scene.{setting}" for setting in settings]
        source = run.folder_or_refuse().pipeline
        loaded = load_scene(build_pipeline(source, ["protocol=null", *changes]))
        views = (*loaded.train, *loaded.test)
        extent = run.scene.extent
        moved = [
            v.name for v in views if v.name in trained and _moved(v.camera, trained[v.name], extent)
        ]
        if moved:
            raise RunError(
                f"with these settings, the camera of {moved[0]} is elsewhere than in the run",
                where=" ".join(settings),
                fix="use settings that only choose the photographs, such as train_views=0",
            )
    others = [view for view in views if view.name not in trained]
    return [view.name for view in others], [view.camera for view in others]


def _moved(camera: Camera, other: Camera, extent: float) -> bool:
    turned = camera.world_to_camera[:3, :3] - other.world_to_camera[:3, :3]
    shift = (camera.center - other.center) / extent
    return max(float(turned.abs().max()), float(shift.abs().max())) > _SAME
