"""Photographs, cameras and points: what a scene loader returns, and what of it training may see."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from ..errors import PluginError
from .fact import Fact, FactValue
from .maps import DepthMap

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Camera


def camera_extent(cameras: Sequence[Camera]) -> float:
    """1.1 times the largest distance of a camera from their mean (3DGS), world units."""
    import torch

    centers = torch.stack([camera.center for camera in cameras])
    return 1.1 * float((centers - centers.mean(0)).norm(dim=1).max())


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Points that Gaussians start from.

    Args:
        positions: `[P, 3]` float32, world units.
        colors: `[P, 3]` float32 in [0, 1].
        scales: `[P]` float32 standard deviations in world units, or None: chosen by the host from
            the distance to the three nearest neighbours.
        opacities: `[P]` float32 in (0, 1), or None: the pipeline's initial opacity.
        facts: what the maker of the points wants people to know; goes into the results.
        pictures: `[H, W, 3]` in [0, 1] by file name without ending; the run keeps them as PNG.
        maps: what is known of each training view's depth, by the view's name, for components that
            train on it (`Step.maps`); empty if the initializer knows nothing.
        kinds: which points are measured and which are guessed, `[P]` bool by the kind's name, for
            example "confirmed" and "margin"; a point may be of several. Gaussians that descend from a
            point stay of its kinds, so that a kind can be left out of what is looked at, and components
            can tell them apart (`Step.kinds`). Empty: nothing is told apart.
    """

    positions: Tensor
    colors: Tensor
    scales: Tensor | None = None
    opacities: Tensor | None = None
    facts: Mapping[str, Any] = field(default_factory=dict)
    pictures: Mapping[str, Tensor] = field(default_factory=dict)
    maps: Mapping[str, DepthMap] = field(default_factory=dict)
    kinds: Mapping[str, Tensor] = field(default_factory=dict)

    def __len__(self) -> int:
        return int(self.positions.shape[0])


SOLID = 0.99
"""Of a photograph or a render: a pixel of more alpha shows no background (253 and up of 255)."""


@dataclass(frozen=True, eq=False)
class TrainingView:
    """One photograph and the camera that took it, as components see it while they train.

    Args:
        name: unique within the scene; used as a file name for renders.
        camera: pose and intrinsics; its size is the size of `image`.
        image: `[H, W, 3]` float32 in [0, 1], already composited on the scene's background.
        mask: `[H, W]` bool, True where pixels count in metrics; None where all do.
        alpha: `[H, W]` float32 in [0, 1], how much of each pixel the photographed object covers;
            None where the photograph does not say.
    """

    name: str
    camera: Camera
    image: Tensor
    mask: Tensor | None = None
    alpha: Tensor | None = None

    @property
    def solid(self) -> Tensor | None:
        """`[H, W]` bool, pixels that the object covers wholly; None where the photograph does not say.

        Depth is to be compared there alone. Where the background shines through, blended depth is too small,
        and a loss that wants more of it pulls Gaussians of the background's colour over the rim.
        """
        return None if self.alpha is None else self.alpha > SOLID

    @property
    def depth(self) -> Tensor | None:
        """Not available during training: true depth is for evaluation (`View.depth`).

        Raises:
            PluginError: always.
        """
        raise PluginError(
            f"the true depth of the training view {self.name!r} is not available during training",
            fix="train on photographs, or on depth that a prior or the initializer estimates",
        )


@dataclass(frozen=True, eq=False)
class View(TrainingView):
    """A photograph as evaluation sees it.

    Args:
        depth: `[H, W]` float32 true z-depth where a data set knows it (0 = unknown).
    """

    depth: Tensor | None = None

    def for_training(self) -> TrainingView:
        """The same photograph without its truth."""
        return TrainingView(self.name, self.camera, self.image, self.mask, self.alpha)


@dataclass(frozen=True, eq=False)
class TrainingScene:
    """What initializers and training may know of a scene: no test views, no true depth.

    Args:
        name: for messages.
        train: the photographs to learn from; at least one.
        bounds: (near, far) z-depth of the scene's content in world units, 0 < near < far.
        points: sparse points seen by the training views alone, or None.
        background: colour behind the scene, three numbers in [0, 1].
    """

    name: str
    train: tuple[TrainingView, ...]
    bounds: tuple[float, float]
    points: PointCloud | None = None
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def extent(self) -> float:
        """That of the training cameras (`camera_extent`), world units.

        A single camera, or cameras at one place, have no extent; 0.1 times the far bound stands in
        so that learning rates do not vanish.
        """
        radius = camera_extent([view.camera for view in self.train])
        return radius if radius > 1e-9 * self.bounds[1] else 0.1 * self.bounds[1]

    @property
    def test(self) -> tuple[View, ...]:
        """Not available during training: test views are for evaluation.

        Raises:
            PluginError: always.
        """
        raise PluginError(
            "the test views are not available during training",
            fix="use scene.train: a method that learns from test views cannot be scored on them",
        )


@dataclass(frozen=True, eq=False)
class Scene:
    """Photographs with known cameras, split into training and test views.

    Args:
        name: for titles and tables.
        train: the views that training may look at; at least one.
        test: the views that are rendered and scored; may be empty.
        bounds: (near, far) z-depth of the scene's content in world units, 0 < near < far.
        points: sparse points seen by the training views alone, or None.
        background: colour behind the scene, three numbers in [0, 1].
        facts: what the loader wants on record beside that: where photographs come from, how they were
            changed and split. They go into the results.
    """

    name: str
    train: tuple[View, ...]
    test: tuple[View, ...]
    bounds: tuple[float, float]
    points: PointCloud | None = None
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    facts: tuple[Fact, ...] = ()

    @property
    def extent(self) -> float:
        """The extent of its training cameras (`TrainingScene.extent`), world units."""
        return self.for_training().extent

    def for_training(self) -> TrainingScene:
        """What components may see of it before evaluation."""
        views = tuple(view.for_training() for view in self.train)
        return TrainingScene(self.name, views, self.bounds, self.points, self.background)

    def fact(self, name: str) -> FactValue:
        """The value of the fact of that name; KeyError if there is none."""
        return {fact.name: fact.value for fact in self.facts}[name]
