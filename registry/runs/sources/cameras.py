"""The cameras of a run's scene, for renders where its photographs are not at hand."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NoReturn

import torch
from torch import Tensor

from core_rasterizer import Camera, ExplainedError

from ...contract.scene import Scene, View
from ...pipeline.settings_check import leaves
from ..results import Record

if TYPE_CHECKING:
    from collections.abc import Mapping

_OPTIONAL = ("mask", "alpha", "weights")
"""Images of a view besides the photograph; those that it had are absent, not None."""


class ViewRecord(Record):
    """A view without its images: the camera in the file's coordinates, and the images that it had."""

    name: str
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    world_to_camera: list[list[float]]
    images: list[str]


class CamerasRecord(Record):
    """Content of cameras.json."""

    name: str
    bounds: list[float]
    background: list[float]
    train: list[ViewRecord]
    test: list[ViewRecord]


class _Absent(Tensor):
    """Stands for an image that was not loaded; whatever uses it raises the error of the loading."""

    error: ExplainedError

    @classmethod
    def because(cls, error: ExplainedError) -> _Absent:
        absent = torch.empty(0).as_subclass(cls)
        absent.error = error
        return absent

    @classmethod
    def __torch_function__(
        cls, function: Any, types: Any, given: Any = (), options: Any = None
    ) -> NoReturn:
        raise next(leaves([given, options], cls)).error


def cameras_of(scene: Scene) -> CamerasRecord:
    """Return the record of a scene's cameras, bounds and background."""
    return CamerasRecord(
        name=scene.name,
        bounds=list(scene.bounds),
        background=list(scene.background),
        train=[_record(view) for view in scene.train],
        test=[_record(view) for view in scene.test],
    )


def scene_of(content: Mapping[str, Any], error: ExplainedError) -> Scene:
    """Return the scene of a record; the use of its photographs raises `error`."""
    record = CamerasRecord.model_validate(content)
    near, far = record.bounds
    red, green, blue = record.background
    train, test = (_views(views, _Absent.because(error)) for views in (record.train, record.test))
    return Scene(record.name, train, test, (near, far), background=(red, green, blue))


def _record(view: View) -> ViewRecord:
    camera = view.camera
    return ViewRecord(
        name=view.name,
        width=camera.width,
        height=camera.height,
        fx=camera.fx,
        fy=camera.fy,
        cx=camera.cx,
        cy=camera.cy,
        world_to_camera=camera.world_to_camera.tolist(),
        images=[name for name in _OPTIONAL if getattr(view, name) is not None],
    )


def _views(records: Sequence[ViewRecord], image: Tensor) -> tuple[View, ...]:
    return tuple(
        View(
            record.name,
            Camera(
                torch.tensor(record.world_to_camera, dtype=torch.float64),
                fx=record.fx,
                fy=record.fy,
                cx=record.cx,
                cy=record.cy,
                width=record.width,
                height=record.height,
            ),
            image,
            **dict.fromkeys(record.images, image),
        )
        for record in records
    )
