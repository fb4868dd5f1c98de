"""A tiny scene and Gaussians that look at it, made anew for every question."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch

from core_rasterizer import Camera, Device, GaussianModel, Rendering, photometric_loss

from ..contract.maps import DepthMap
from ..contract.prior import Prior
from ..contract.scene import PointCloud, Scene, View, validate
from ..contract.step import OtherField, Sample, Step
from ..pipeline.training_settings import TrainingSettings
from ..training.initial_model import initial_gaussians, new_model
from ..training.learning_rates import learning_rates
from ..training.step_rendering import StepRenderer
from .judging import require

WIDTH, HEIGHT = 32, 24
_SETTINGS = TrainingSettings(iterations=100, sh_degree=1)


@dataclass(frozen=True, eq=False)
class Moment:
    """One moment of an iteration, and the Gaussians behind what the component sees."""

    step: Step
    model: GaussianModel


@dataclass
class Bench:
    """Where a component is tried.

    Args:
        device: where the Gaussians live.
        priors: what components are given.
    """

    device: Device
    priors: dict[str, Prior[Any]]

    @property
    def scene(self) -> Scene:
        """Three views of smooth colours, two to train and one to test, with 60 points."""
        return tiny_scene()

    def model(self) -> GaussianModel:
        """Gaussians at the scene's points."""
        points = self.scene.points
        assert points is not None
        return new_model(initial_gaussians(points, _SETTINGS), _SETTINGS, self.device)

    def begun(self) -> Moment:
        """Before the render."""
        scene, model = self.scene.for_training(), self.model()
        view = scene.train[0]
        sample = Sample(view, view.camera, view.image, scene.background, _SETTINGS.sh_degree)
        depth = torch.full(view.image.shape[:2], 3.0)
        known = torch.ones_like(depth, dtype=torch.bool)
        step = Step(
            iteration=10,
            iterations=_SETTINGS.iterations,
            scene=scene,
            sample=sample,
            model=model.reader(),
            extent=scene.extent,
            priors=self.priors,
            render=StepRenderer(model, sample),
            log=_log,
            maps={view.name: DepthMap(depth, known, known.float()) for view in scene.train},
            learning_rates=learning_rates(10, _SETTINGS, scene.extent),
        )
        return Moment(step, model)

    def rendered(self) -> Moment:
        """After the render; there is one other field."""
        moment = self.begun()
        step = moment.step
        rendering = moment.model.render(step.view.camera, collect_statistics=True)
        step.rendered(lambda: rendering)
        other = self.model()
        look = StepRenderer(other, step.sample, gradients=False)
        step.others = (OtherField(1, other.reader(), look(step.view.camera), look),)
        return moment

    def differentiated(self) -> Moment:
        """After the backward pass."""
        moment = self.rendered()
        rgb, target = moment.step.rendering.rgb, moment.step.sample.target
        photometric_loss(rgb, target, device=self.device).backward()
        return moment


def tiny_scene() -> Scene:
    """Three cameras side by side that look at points between z = 2 and 4, and a wall at 3; 32x24."""
    generator = torch.Generator().manual_seed(1)
    rows = torch.linspace(0, 1, HEIGHT)[:, None].expand(HEIGHT, WIDTH)
    columns = torch.linspace(0, 1, WIDTH)[None].expand(HEIGHT, WIDTH)
    views = []
    for index in range(3):
        pose = torch.eye(4)
        pose[0, 3] = 0.2 * (1 - index)
        image = torch.stack([rows, columns, torch.full_like(rows, 0.2 + 0.3 * index)], dim=2)
        camera = Camera(pose, 30.0, 30.0, WIDTH / 2, HEIGHT / 2, WIDTH, HEIGHT)
        views.append(View(f"view{index}", camera, image, depth=torch.full_like(rows, 3.0)))
    positions = torch.rand(60, 3, generator=generator) * 2 - 1
    positions[:, 2] += 3
    points = PointCloud(positions, torch.rand(60, 3, generator=generator))
    return validate(
        Scene("tiny", (views[0], views[2]), (views[1],), bounds=(1.5, 5.0), points=points)
    )


def pictured(view: View, depth_factor: float) -> Rendering:
    """A render that shows the view's photograph, and its true depth times a factor."""
    assert view.depth is not None
    return Rendering(view.image, depth_factor * view.depth, torch.ones(HEIGHT, WIDTH))


def _log(name: str, value: float) -> None:
    require(isinstance(name, str), "step.log takes a name and a number")
    float(value)
