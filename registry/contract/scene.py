"""What a scene loader returns, and the one check that every loader ends in."""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from ..errors import PluginError, SceneError
from .fact import Fact, FactValue
from .maps import DepthMap

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Camera

    from .maps import DepthMap

_FACT_NAME = re.compile(r"[A-Za-z0-9_-]+")
_ROTATION_TOLERANCE = 1e-4
_FARTHEST = 1e9
"""World units; beyond, squares and products of positions leave single precision."""
_FEWEST_BESIDE_COPIES = 3
"""Training views that a scene must have beside those that are left out."""
_log = logging.getLogger("stereogs.scene")
_FOCAL_RANGE = (1e-2, 1e4)
"""In units of the longer side of the image: from 179 degrees of view to 20 seconds of arc."""


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
        """Not to be had: true depth is for evaluation (`View.depth`).

        Raises:
            PluginError: always.
        """
        raise PluginError(
            f"the true depth of the training view {self.name!r} was asked for; it is for evaluation",
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
        """Not to be had: training never sees a test view.

        Raises:
            PluginError: always.
        """
        raise PluginError(
            "the test views were asked for; they are for evaluation",
            fix="use scene.train: what learns from test views cannot be scored on them",
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


def validate(scene: Scene) -> Scene:
    """Refuse a scene that training could not use; return it otherwise.

    Of training views with one pose the first stays, if at least three views do; a warning and a fact
    name the others.

    Raises:
        SceneError: no training view; a repeated or unsafe name; two of few views from one pose; a
            rotation that is none (to 1e-4), a focal length or position beyond belief; an image whose
            size is not the camera's, whose values are not finite or not in [0, 1]; a mask that is not
            bool, does not fit or leaves no pixel; an alpha that does not fit or is not in [0, 1]; a
            depth that does not fit or is not finite; points
            that are not finite or have colours outside [0, 1]; bounds out of order; two facts of one
            name, or a fact that JSON cannot say.
    """
    if not scene.train:
        raise SceneError(
            "the scene has no training view", where=scene.name, fix="check the folder and the split"
        )
    seen: set[str] = set()
    for view in (*scene.train, *scene.test):
        _validate_view(view, scene.name)
        if view.name in seen:
            raise SceneError(f"two views are named {view.name!r}", where=scene.name)
        seen.add(view.name)
    scene = _without_equal_poses(scene)
    near, far = scene.bounds
    if not 0 < near < far < float("inf"):
        raise SceneError(
            f"the depth bounds are ({near:g}, {far:g}); they must satisfy 0 < near < far",
            where=scene.name,
        )
    if scene.points is not None:
        _validate_points(scene.points, scene.name)
    _validate_facts(scene)
    return scene


def _validate_view(view: View, scene_name: str) -> None:
    where = f"{scene_name}, view {view.name!r}"
    if not is_file_name(view.name):
        raise SceneError("a view's name must be a plain file name", where=where)
    _validate_camera(view.camera, where)
    camera, image = view.camera, view.image
    if image.shape != (camera.height, camera.width, 3):
        raise SceneError(
            f"the image has shape {tuple(image.shape)} but its camera is "
            f"{camera.width}x{camera.height}",
            where=where,
            fix="use images of one size, the size that the poses were made for",
        )
    low, high = image.aminmax()  # one pass; a NaN becomes both and compares as false
    if not 0 <= low <= high <= 1:
        raise SceneError("the image has values outside [0, 1] or not finite", where=where)
    _validate_maps(view, where)


def is_file_name(name: str) -> bool:
    """Whether a name can be a file's, with an ending added, on any usual system."""
    separators = "/" in name or "\\" in name
    return bool(name.strip(". ")) and not separators and name.isprintable() and len(name) <= 200


def _validate_camera(camera: Camera, where: str) -> None:
    """What `Camera` lets pass and no photograph has."""
    import torch

    rotation = camera.world_to_camera[:3, :3]
    residual = float((rotation @ rotation.T - torch.eye(3, dtype=rotation.dtype)).abs().max())
    if residual > _ROTATION_TOLERANCE:
        raise SceneError(
            f"the rotation is not orthonormal (off by {residual:.2g})",
            where=where,
            fix="write poses with more digits, and without scale",
        )
    if camera.world_to_camera[:3, 3].abs().max() > _FARTHEST:
        raise SceneError("the camera stands too far away for single precision", where=where)
    size = max(camera.width, camera.height)
    for name in ("fx", "fy"):
        focal = getattr(camera, name)
        if not size * _FOCAL_RANGE[0] < focal < size * _FOCAL_RANGE[1]:
            raise SceneError(
                f"the focal length {name} is {focal:g} px for an image of "
                f"{camera.width}x{camera.height}",
                where=where,
                fix="check whether the focal length belongs to another image size or unit",
            )


def _validate_maps(view: View, where: str) -> None:
    """The mask and the depth."""
    import torch

    for name, array in (("mask", view.mask), ("alpha", view.alpha), ("depth", view.depth)):
        if array is not None and array.shape != view.image.shape[:2]:
            raise SceneError(
                f"the {name} has shape {tuple(array.shape)}, not {tuple(view.image.shape[:2])}",
                where=where,
            )
    if view.mask is not None and view.mask.dtype != torch.bool:
        raise SceneError(f"the mask is {view.mask.dtype}, not bool", where=where)
    if view.mask is not None and not view.mask.any():
        raise SceneError(
            "the mask leaves no pixel to measure", where=where, fix="take the mask or the view out"
        )
    if view.alpha is not None:
        low, high = view.alpha.aminmax()
        if not 0 <= low <= high <= 1:
            raise SceneError("the alpha has values outside [0, 1] or not finite", where=where)
    if view.depth is not None and not (torch.isfinite(view.depth).all() and view.depth.min() >= 0):
        raise SceneError("the depth has values that are negative or not finite", where=where)


def _without_equal_poses(scene: Scene) -> Scene:
    """Leave out training views whose pose an earlier one has: they have no parallax.

    Raises:
        SceneError: fewer than three others would be left; one of the poses is most likely a copy.
    """
    kept: list[View] = []
    copies: list[tuple[View, View]] = []
    for view in scene.train:
        twin = next((other for other in kept if _same_pose(view, other)), None)
        if twin is None:
            kept.append(view)
        else:
            copies.append((twin, view))
    if not copies:
        return scene
    if len(kept) < _FEWEST_BESIDE_COPIES:
        first, second = copies[0]
        raise SceneError(
            f"the training views {first.name!r} and {second.name!r} have the same pose: "
            "two photographs from one place say nothing about depth",
            where=scene.name,
            fix="leave one of them out, or correct its pose",
        )
    for first, second in copies:
        _log.warning(
            "%s: the training views %s and %s have the same pose; %s is left out",
            *(scene.name, first.name, second.name, second.name),
        )
    fact = Fact("left_out_for_equal_pose", ", ".join(view.name for _, view in copies))
    return replace(scene, train=tuple(kept), facts=(*scene.facts, fact))


def _same_pose(view: View, other: View) -> bool:
    import torch

    first, second = view.camera.world_to_camera, other.camera.world_to_camera
    return torch.allclose(first, second, rtol=1e-9, atol=1e-9)


def _validate_facts(scene: Scene) -> None:
    names = [fact.name for fact in scene.facts]
    for fact in scene.facts:
        if not _FACT_NAME.fullmatch(fact.name) or names.count(fact.name) > 1:
            raise SceneError(
                f"the fact {fact.name!r} has no plain name of its own",
                where=scene.name,
                fix="letters, digits, '-' and '_'; each name once",
            )
        numbers = fact.value if isinstance(fact.value, tuple) else (fact.value,)
        if not all(isinstance(n, str) or math.isfinite(n) for n in numbers):
            raise SceneError(f"the fact {fact.name!r} is not finite", where=scene.name)


def _validate_points(points: PointCloud, scene_name: str) -> None:
    import torch

    for name in ("positions", "colors"):
        array: Tensor = getattr(points, name)
        if array.ndim != 2 or array.shape[1] != 3 or array.shape[0] != len(points):
            raise SceneError(
                f"the points' {name} have shape {tuple(array.shape)}, not ({len(points)}, 3)",
                where=scene_name,
            )
        finite = torch.isfinite(array).all(dim=1)
        if not finite.all():
            first = int((~finite).nonzero()[0])
            raise SceneError(f"points.{name}[{first}] is not finite", where=scene_name)
    if len(points) and not 0 <= points.colors.min() <= points.colors.max() <= 1:
        raise SceneError("the points have colours outside [0, 1]", where=scene_name)
