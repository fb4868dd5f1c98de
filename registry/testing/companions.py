"""Components and pipelines around the component under test."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch

from core_rasterizer import Edit, Gaussians, Relocation

from ..contract.component import Component, Settings
from ..contract.components import (
    IN_MEMORY,
    Densification,
    Initializer,
    InMemoryScene,
    Metric,
)
from ..contract.hook_points import PIPELINE_POINTS, HookPoint
from ..contract.prior import Prior
from ..contract.scene import PointCloud, TrainingScene
from ..contract.step import Step
from ..pipeline.pipeline import Item, Pipeline
from ..pipeline.schedule import HostSettings
from ..pipeline.training_settings import TrainingSettings
from ..pipeline.yaml_source import Place
from ..plugins.discovery import Offer

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
    for point in PIPELINE_POINTS:
        if isinstance(component, type) and issubclass(component, point.base):
            return point
    raise AssertionError(f"{component.__name__} derives from none of the component bases")
