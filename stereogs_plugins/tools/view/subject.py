"""What is looked at: Gaussians, and what is known about the photographs that they were made from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from torch import Tensor

from core_rasterizer import Camera, Device, GaussianModel, Gaussians, load_ply
from registry import Scene
from registry.runs import Run
from registry.training import new_model

from .camera_list import cameras_beside


@dataclass(frozen=True, eq=False)
class Standpoint:
    """From where a photograph was taken.

    Args:
        name: the view's.
        camera: its lens and place.
        photograph: `[H, W, 3]` in [0, 1]; None where it is not at hand.
        is_test: whether training did not see it.
    """

    name: str
    camera: Camera
    photograph: Tensor | None = None
    is_test: bool = False


@dataclass(frozen=True, eq=False)
class Subject:
    """Gaussians to be looked at.

    Args:
        name: for the page's title.
        model: the Gaussians.
        standpoints: of their photographs, those that training saw first; none for a file alone.
        background: behind them, three numbers in [0, 1].
        kinds: which Gaussians descend from initial points of a kind, `[N]` bool by its name.
    """

    name: str
    model: GaussianModel
    standpoints: tuple[Standpoint, ...] = ()
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    kinds: Mapping[str, Tensor] = field(default_factory=dict)


def of_run(run: Run) -> Subject:
    """A run as it stands."""
    return _of(run, run.model, run.kinds)


def snapshot(run: Run) -> Subject:
    """A copy of a run's Gaussians, which training on does not change.

    Raises:
        GaussianError: one is not finite; training removes such ones before long.
    """
    kept = run.checkpoint()
    gaussians = Gaussians(**kept.part("model"))
    model = new_model(gaussians, run.pipeline.training, run.model.device)
    return _of(run, model, kept.part("kinds"))


def of_file(path: Path, device: Device) -> Subject:
    """The Gaussians of a PLY file, and the cameras of the `cameras.json` that may lie beside it.

    Raises:
        PlyError: it cannot be read, or holds no Gaussians.
    """
    cameras = cameras_beside(path)
    standpoints = tuple(Standpoint(name, camera) for name, camera in cameras)
    return Subject(path.name, GaussianModel(load_ply(path), device), standpoints)


def _of(run: Run, model: GaussianModel, kinds: Mapping[str, Tensor]) -> Subject:
    title = f"{run.scene.name}, {run.pipeline.name}"
    return Subject(title, model, standpoints_of(run.scene), run.scene.background, kinds)


def standpoints_of(scene: Scene) -> tuple[Standpoint, ...]:
    """Of the training views, then of the test views."""
    return (
        *(Standpoint(view.name, view.camera, view.image) for view in scene.train),
        *(Standpoint(view.name, view.camera, view.image, is_test=True) for view in scene.test),
    )
