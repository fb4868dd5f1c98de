"""What stands beside a component in the pipelines that it is tried in: the host's own, tried ones."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from core_rasterizer import Edit, Gaussians, Relocation

from ..contract.component import Component, Settings
from ..contract.components import Densification, Initializer, Metric
from ..contract.hook_points import PIPELINE_POINTS, HookPoint
from ..contract.in_memory import IN_MEMORY, InMemoryScene
from ..contract.prior import Prior
from ..contract.scene import PointCloud, TrainingScene
from ..contract.step import Step
from ..pipeline.pipeline import Item, Pipeline
from ..pipeline.schedule import HostSettings
from ..pipeline.training_settings import TrainingSettings
from ..pipeline.yaml_source import Place
from ..plugins.discovery import Offer

UNDER_TEST = "under_test"
"""What a component is called in a pipeline that it is tried in."""


class ScenePoints(Initializer[Settings]):
    """The scene's own points."""

    def initialize(self, scene: TrainingScene, priors: Mapping[str, Prior[Any]]) -> PointCloud:
        """Return them."""
        assert scene.points is not None
        return scene.points


class MeanError(Metric[Settings]):
    """Mean absolute error of colours."""

    higher_is_better = False

    def measure(self, rendered: Tensor, photograph: Tensor, mask: Tensor | None) -> float:
        """Of the whole image."""
        return float((rendered - photograph).abs().mean())


class RandomEdits(Densification[Settings]):
    """One kind of edit after the other, each leaving at least one Gaussian; in every third iteration.

    In the others the optimizer takes its step, which it does not after an edit.
    """

    def refine(self, step: Step) -> Edit | None:
        """Return the edit of this iteration."""
        if step.iteration % 3 != 1:
            return None
        count = step.model.count
        number = torch.arange(count)
        few = number % 5
        added = _copies(step, 2)
        parents = torch.full((len(added),), count - 1)
        edits = (
            Edit(clone=few == 0, prune=few == 1),
            Edit(split=few == 2),
            Edit(relocate=_relocation(number)),
            Edit(add=added, parents=parents, prune=few == 3),
        )
        return edits[step.iteration // 3 % len(edits)]


def _copies(step: Step, count: int) -> Gaussians:
    """Copies of the first Gaussian."""
    every = vars(step.model.gaussians())
    return Gaussians(**{name: values[[0] * count] for name, values in every.items()})


def _relocation(number: Tensor) -> Relocation | None:
    """The first two become copies of the last two, where there are so many."""
    return Relocation(number[-2:], number[:2]) if len(number) >= 4 else None


def pipeline_of(items: list[Item], training: TrainingSettings) -> Pipeline:
    """A pipeline of these components, for a scene that is given, with points and a score if none is."""
    given = {
        point.section: tuple(i for i in items if i.point is point) for point in PIPELINE_POINTS
    }
    usual = {
        "scene": item(InMemoryScene, Settings(), IN_MEMORY),
        "initializer": item(ScenePoints, Settings(), "scene_points"),
        "metrics": item(MeanError, Settings(), "mean_error"),
    }
    filled = {name: given[name] or (one,) for name, one in usual.items()}
    return Pipeline("conformance", {**given, **filled}, training)


def item(component: type[Component[Any]], settings: Settings, name: str) -> Item:
    """A component as a pipeline would name it."""
    point = point_of(component)
    offer = Offer(point, name, component, name, "registry.testing", "0")
    return Item(name, settings, HostSettings(use=name), offer, Place(f"the component {name}"))


def point_of(component: type[Component[Any]]) -> HookPoint:
    """The hook point that a class is for.

    Raises:
        AssertionError: it derives from none of the bases.
    """
    for point in PIPELINE_POINTS:
        if isinstance(component, type) and issubclass(component, point.base):
            return point
    raise AssertionError(f"{component.__name__} derives from none of the component bases")
