"""A tiny scene and Gaussians that look at it, made anew for every question."""

from __future__ import annotations

from collections.abc import Callable, Mapping
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
        scene, model = self.scene, self.model()
        depth = torch.full((HEIGHT, WIDTH), 3.0)
        known = torch.ones_like(depth, dtype=torch.bool)
        maps = {view.name: DepthMap(depth, known, known.float()) for view in scene.train}
        return Moment(step_of(model, scene, priors=self.priors, maps=maps), model)

    def rendered(self, *, absolute: bool = False) -> Moment:
        """After the render; there is one other field.

        Args:
            absolute: collect absolute screen gradients too.
        """
        moment = self.begun()
        step = moment.step
        rendering = moment.model.render(
            step.view.camera, collect_statistics=True, collect_absolute=absolute
        )
        step.rendered(lambda: rendering)
        other = self.model()
        look = StepRenderer(other, step.sample, gradients=False)
        step.others = (OtherField(1, other.reader(), look(step.view.camera), look),)
        return moment

    def differentiated(self, *, absolute: bool = False) -> Moment:
        """After the backward pass; see `rendered`."""
        moment = self.rendered(absolute=absolute)
        rgb, target = moment.step.rendering.rgb, moment.step.sample.target
        photometric_loss(rgb, target, device=self.device).backward()
        return moment


def step_of(
    model: GaussianModel,
    scene: Scene,
    *,
    rendering: Rendering | None = None,
    iteration: int = 10,
    iterations: int = 100,
    extent: float | None = None,
    priors: Mapping[str, Prior[Any]] | None = None,
    maps: Mapping[str, DepthMap] | None = None,
    log: Callable[[str, float], None] | None = None,
) -> Step:
    """An iteration that looks at a scene's first training view, for tests of one's own.

    Args:
        model: the Gaussians.
        scene: the step sees it without test views and true depth.
        rendering: of that view; None for the moment before the render.
        iteration, iterations: the number of this one, and of all.
        extent: world units; None takes the scene's.
        priors: prior models by name.
        maps: the initializer's depth by the view's name.
        log: what `step.log` calls; None only checks that it is given a name and a number.
    """
    known, settings = scene.for_training(), TrainingSettings(iterations=iterations)
    extent = known.extent if extent is None else extent
    view = known.train[0]
    sample = Sample(view, view.camera, view.image, known.background, model.sh_degree)
    step = Step(
        iteration=iteration,
        iterations=iterations,
        scene=known,
        sample=sample,
        model=model.reader(),
        extent=extent,
        priors=priors or {},
        render=StepRenderer(model, sample),
        log=log or _check_log,
        maps=maps or {},
        learning_rates=learning_rates(iteration, settings, extent),
    )
    if rendering is not None:
        step.rendered(lambda: rendering)
    return step


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


def _check_log(name: str, value: float) -> None:
    require(isinstance(name, str), "step.log takes a name and a number")
    float(value)
