"""Small scenes with known depth, training iterations, and pipelines around the component under test."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from core_rasterizer import Camera, Edit, Gaussians, Model, Relocation, Rendering

from ..contract.checks.scene import validate
from ..contract.component import Component, Settings
from ..contract.components import (
    IN_MEMORY,
    Densification,
    Initializer,
    InMemoryScene,
    Metric,
)
from ..contract.hook_points import HOOK_POINTS, PIPELINE_POINTS, HookPoint
from ..contract.prior import Prior
from ..contract.rendered import Access
from ..contract.scene import DepthMap, PointCloud, Scene, TrainingScene, View
from ..contract.step import Sample, Step
from ..discovery import Offer
from ..pipeline.pipeline import Item, Pipeline
from ..pipeline.schedule import HostSettings
from ..pipeline.training_settings import TrainingSettings
from ..pipeline.yaml_source import Place
from ..training.step import OUTPUTS, StepReader, learning_rates, step_renderer
from .assertions import require


@dataclass(frozen=True)
class Size:
    """Size of a scene.

    Args:
        title: for messages.
        width, height: of the images, in pixels.
        points: number of points.
        hidden: no Gaussian is in view, each image has one colour, and no points or depth are known.
    """

    title: str
    width: int
    height: int
    points: int
    hidden: bool = False

    @property
    def degenerate(self) -> bool:
        """Whether too little is visible for a meaningful answer."""
        return self.hidden or self.points == 1


SMALL = Size("a small scene", 32, 24, 60)
REAL = Size("images of 320 x 240 and 5,000 Gaussians", 320, 240, 5000)
EMPTY = Size("a scene with nothing in view", 32, 24, 60, hidden=True)
PIXEL = Size("images of one pixel and one Gaussian", 1, 1, 1)


def tiny_scene() -> Scene:
    """Three cameras side by side that look at points between z = 2 and 4, and a wall at 3; 32x24."""
    return scene_of(SMALL)


def scene_of(size: Size) -> Scene:
    """Return two training views with a test view between them that look along +z at a wall at z = 3."""
    left, middle, right = (_view(size, index) for index in range(3))
    points = None if size.hidden else points_of(size)
    return validate(Scene("tiny", (left, right), (middle,), bounds=(1.5, 5.0), points=points))


def _view(size: Size, index: int) -> View:
    width, height = size.width, size.height
    rows = torch.linspace(0, 1, height)[:, None].expand(height, width)
    columns = torch.linspace(0, 1, width)[None].expand(height, width)
    image = torch.stack([rows, columns, torch.full_like(rows, 0.2 + 0.3 * index)], dim=2)
    if size.hidden:
        image = torch.full((height, width, 3), 0.5)
    pose = torch.eye(4)
    pose[0, 3] = 0.2 * (1 - index)
    camera = Camera.centered(pose, 30 / 32 * width, width, height)
    depth = torch.full((height, width), 0.0 if size.hidden else 3.0)
    return View(f"view{index}", camera, image, depth=depth)


def points_of(size: Size) -> PointCloud:
    """Return points of random colours between z = 2 and 4, or far behind the cameras."""
    generator = torch.Generator().manual_seed(1)
    positions = torch.rand(size.points, 3, generator=generator) * 2 - 1
    positions[:, 2] += -30 if size.hidden else 3
    return PointCloud(positions, torch.rand(size.points, 3, generator=generator))


def step_of(
    model: Model,
    scene: Scene,
    *,
    rendering: Rendering | None = None,
    iteration: int = 10,
    iterations: int = 100,
    extent: float | None = None,
    priors: Mapping[str, Prior[Any]] | None = None,
    maps: Mapping[str, DepthMap] | None = None,
    kinds: Mapping[str, Tensor] | None = None,
    log: Callable[[str, float], None] | None = None,
    shrink: int = 1,
) -> Step:
    """Return an iteration that trains on a scene's first training view, for your own tests.

    Args:
        model: the Gaussians.
        scene: the step sees it without test views and true depth.
        rendering: of that view; None for an iteration before the render.
        iteration, iterations: number of this iteration, and of all.
        extent: world units; None uses the scene's.
        priors: prior models by name.
        maps: the initializer's depth by the view's name.
        kinds: which Gaussians descend from initial points of a kind.
        log: called by `step.log`; None only checks that it gets a name and a number.
        shrink: >= 1; the view has this many times the columns and rows of the sample's camera and target.
    """
    known, settings = scene.for_training(), TrainingSettings(iterations=iterations)
    access = Access()
    extent = known.extent if extent is None else extent
    view = known.train[0]
    degree, weights = model.sh_degree, view.weights
    sample = Sample(view, view.camera, view.image, known.background, degree, weights=weights)
    if shrink > 1:
        target = view.image[::shrink, ::shrink].contiguous()
        camera = view.camera.resized(target.shape[1], target.shape[0])
        weights = None if weights is None else weights[::shrink, ::shrink]
        sample = replace(sample, camera=camera, target=target, weights=weights)
    step = Step(
        iteration=iteration,
        iterations=iterations,
        scene=known,
        sample=sample,
        model=StepReader(model, access),
        extent=extent,
        priors=priors or {},
        render=step_renderer(model, sample),
        log=log or _check_log,
        maps=maps or {},
        kinds=kinds or {},
        learning_rates=learning_rates(iteration, settings, extent),
        makers=OUTPUTS,
        access=access,
    )
    if rendering is not None:
        step.rendered(lambda: rendering)
    return step


def _check_log(name: str, value: float) -> None:
    require(isinstance(name, str), "step.log takes a name and a number")
    float(value)


UNDER_TEST = "under_test"
"""Name of the component under test in its pipelines."""


class ScenePoints(Initializer[Settings]):
    """The points of the scene."""

    def initialize(self, scene: TrainingScene, priors: Mapping[str, Prior[Any]]) -> PointCloud:
        assert scene.points is not None
        return scene.points


class MeanError(Metric[Settings]):
    """Mean absolute error of the colours."""

    higher_is_better = False

    def measure(
        self, rendered: torch.Tensor, photograph: torch.Tensor, mask: torch.Tensor | None
    ) -> float:
        return float((rendered - photograph).abs().mean())


class RandomEdits(Densification[Settings]):
    """Apply each kind of edit in turn, in every third iteration; at least one Gaussian remains.

    The optimizer skips the iterations of an edit and runs in the others.
    """

    def refine(self, step: Step) -> Edit | None:
        if step.iteration % 3 != 1:
            return None
        count = step.model.count
        number = torch.arange(count)
        group = number % 5
        first = {name: values[[0, 0]] for name, values in vars(step.model.gaussians()).items()}
        edits = (
            Edit(clone=group == 0, prune=group == 1),
            Edit(split=group == 2),
            Edit(relocate=Relocation(number[-2:], number[:2]) if count >= 4 else None),
            Edit(add=Gaussians(**first), parents=torch.full((2,), count - 1), prune=group == 3),
        )
        return edits[step.iteration // 3 % len(edits)]


def pipeline_of(items: list[Item], training: TrainingSettings) -> Pipeline:
    """Return a pipeline of components; it has scene, initializer and metric even if none is given."""
    defaults = [
        pipeline_item(InMemoryScene, Settings(), IN_MEMORY),
        pipeline_item(ScenePoints, Settings(), "scene_points"),
        pipeline_item(MeanError, Settings(), "mean_error"),
    ]

    def section(point: HookPoint) -> tuple[Item, ...]:
        given, usual = (tuple(i for i in of if i.point is point) for of in (items, defaults))
        return given or usual

    sections = {point.section: section(point) for point in PIPELINE_POINTS}
    return Pipeline("conformance", sections, training)


def pipeline_item(component: type[Component[Any]], settings: Settings, name: str) -> Item:
    """Return a component as an item of a pipeline."""
    offer = Offer(hook_point(component), name, component, name, "registry.testing", "0")
    return Item(name, settings, HostSettings(use=name), offer, Place(f"the component {name}"))


def hook_point(component: type[Component[Any]]) -> HookPoint:
    """Return the hook point whose base class a component derives from.

    Raises:
        AssertionError: it derives from none.
    """
    for point in HOOK_POINTS:
        if isinstance(component, type) and issubclass(component, point.base):
            return point
    raise AssertionError(f"{component.__name__} derives from none of the component bases")
