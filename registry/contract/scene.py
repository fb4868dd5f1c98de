"""Scenes, the part of them that training may use, and what priors estimate of their views."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

from ..errors import PluginError, SceneError
from .frame import IN_FILE, Frame

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Camera, Gaussians

FactValue = str | int | float | tuple[int, ...]
SOLID = 0.99
"""Alpha above which a pixel of a photograph or render shows no background (253 of 255 and up)."""


def camera_extent(cameras: Sequence[Camera]) -> float:
    """1.1 times the largest distance of a camera from their mean (3DGS), world units."""
    import torch

    centers = torch.stack([camera.center for camera in cameras])
    return 1.1 * float((centers - centers.mean(0)).norm(dim=1).max())


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Points that Gaussians start from, or whole Gaussians (`of_gaussians`).

    Args:
        positions: `[P, 3]`, world units: float32, or float64 from a scene loader, for coordinates far from
            the origin.
        colors: `[P, 3]` float32 in [0, 1].
        scales: `[P]` float32 standard deviations in world units, or `[P, 3]` along the Gaussians' axes, or
            None: chosen by the host from the distance to the three nearest neighbours.
        opacities: `[P]` float32 in (0, 1), or None: the pipeline's initial opacity.
        quaternions: `[P, 4]` float32 rotations (w, x, y, z) from the Gaussians' axes to the world's, of
            non-zero length, or None: no rotation.
        sh: `[P, K, 3]` float32 spherical-harmonic coefficients, K = 1, 4, 9 or 16, instead of the colours
            (colour = SH + 0.5; `core_rasterizer.Gaussians`), or None. Training uses their bands from
            the start, and leaves out those above its `sh_degree`.
        facts: recorded in the results.
        pictures: `[H, W, 3]` in [0, 1] by file name without extension; the run saves them as PNG.
        maps: known depth of training views, by the view's name, for components that train on it
            (`Step.maps`).
        kinds: `[P]` bool by the kind's name, for example "confirmed" and "margin"; a point may be of
            several kinds. Gaussians that descend from a point keep its kinds (`Step.kinds`), and exports
            can leave a kind out.
    """

    positions: Tensor
    colors: Tensor
    scales: Tensor | None = None
    opacities: Tensor | None = None
    facts: Mapping[str, Any] = field(default_factory=dict)
    pictures: Mapping[str, Tensor] = field(default_factory=dict)
    maps: Mapping[str, DepthMap] = field(default_factory=dict)
    kinds: Mapping[str, Tensor] = field(default_factory=dict)
    quaternions: Tensor | None = None
    sh: Tensor | None = None

    def __len__(self) -> int:
        return int(self.positions.shape[0])

    @staticmethod
    def of_gaussians(gaussians: Gaussians) -> PointCloud:
        """Return points that training turns into these Gaussians; opacities are within 1e-6 of 0 and 1."""
        import torch

        from core_rasterizer import SH_C0

        smallest = torch.finfo(torch.float32).tiny
        return PointCloud(
            positions=gaussians.means,
            colors=(gaussians.sh[:, 0] * SH_C0 + 0.5).clamp(0, 1),
            scales=gaussians.log_scales.exp().clamp(min=smallest),
            opacities=gaussians.opacity_logits.sigmoid().clamp(1e-6, 1 - 1e-6),
            quaternions=gaussians.quaternions,
            sh=gaussians.sh,
        )

    def transformed(self, similarity: Tensor) -> PointCloud:
        """Return the points in another coordinate system, for example a network's answer in the world's.

        Args:
            similarity: `[4, 4]`, scale * rotation and translation, from these coordinates to the others.

        Raises:
            SceneError: it mirrors or shears.
        """
        import torch
        from scipy.spatial.transform import Rotation

        from core_rasterizer.spherical_harmonics import rotated_sh

        linear, shift = similarity[:3, :3].double(), similarity[:3, 3].double()
        unit = float(torch.linalg.det(linear).clamp(min=0)) ** (1 / 3)
        if not torch.allclose(
            linear @ linear.T, unit**2 * torch.eye(3).double(), 1e-4, 1e-4 * unit**2
        ):
            raise SceneError(
                "the points cannot be transformed by a matrix that mirrors or shears",
                fix="pass scale * rotation and translation, for example `camera.camera_to_world`",
            )
        turn, quaternions = Rotation.from_matrix((linear / unit).numpy()), self.quaternions
        if quaternions is not None:  # scipy's order is x, y, z, w
            turn *= Rotation.from_quat(quaternions[:, [1, 2, 3, 0]].numpy())
        if quaternions is not None or (self.scales is not None and self.scales.ndim == 2):
            wxyz = torch.from_numpy(turn.as_quat()).float().roll(1, dims=-1)
            quaternions = wxyz.expand(len(self), 4).contiguous()
        positions = self.positions.double() @ linear.T + shift
        return replace(
            self,
            positions=positions.to(self.positions.dtype),
            scales=None if self.scales is None else self.scales * unit,
            quaternions=quaternions,
            sh=None if self.sh is None else rotated_sh(self.sh, linear / unit),
            maps={name: replace(m, depth=m.depth * unit) for name, m in self.maps.items()},
        )

    def subset(self, chosen: Tensor) -> PointCloud:
        """Return some of the points with all their properties; maps, pictures and facts stay.

        Args:
            chosen: `[P]` bool, or indices.
        """
        per_point = ("positions", "colors", "scales", "opacities", "quaternions", "sh")
        given = {name: getattr(self, name) for name in per_point}
        parts = {name: values[chosen] for name, values in given.items() if values is not None}
        kinds = {name: mask[chosen] for name, mask in self.kinds.items()}
        return replace(self, **parts, kinds=kinds)


@dataclass(frozen=True)
class Fact:
    """Something about a scene that its loader knows and the scene does not show.

    Args:
        name: a word of letters, digits, "-" and "_", unique among a scene's facts.
        value: recorded in the results and compared by `stereogs compare`; numbers finite.
        text: the value in words; empty if the value needs no explanation.
        affects_scores: whether scores of runs with different values are not comparable.
    """

    name: str
    value: FactValue
    text: str = ""
    affects_scores: bool = True

    def __str__(self) -> str:
        if self.text:
            return self.text
        if isinstance(self.value, tuple):
            return ", ".join(map(str, self.value))
        return f"{self.value:g}" if isinstance(self.value, float) else str(self.value)


@dataclass(frozen=True, eq=False)
class TrainingView:
    """One photograph and its camera, as components see it during training.

    Args:
        name: unique within the scene; used as a file name for renders.
        camera: pose and intrinsics; its size is the size of `image`.
        image: `[H, W, 3]` float32 in [0, 1], already composited on the scene's background. In training,
            pixels of weight 0 have the colour of the nearest other pixel.
        mask: `[H, W]` bool, True where pixels count in metrics; None where all do.
        alpha: `[H, W]` float32 in [0, 1], the share of each pixel that the photographed object covers;
            None if the photograph has no alpha.
        weights: `[H, W]` float32 in [0, 1], how much each pixel counts in training; None where all count
            fully. One number below 1 everywhere is the weight of a whole view, for example a generated one.
    """

    name: str
    camera: Camera
    image: Tensor
    mask: Tensor | None = None
    alpha: Tensor | None = None
    weights: Tensor | None = None

    @property
    def solid(self) -> Tensor | None:
        """`[H, W]` bool, pixels of full weight that the object covers completely; None where all are.

        Depth losses should use only these: where the background shines through, blended depth is too small,
        and a loss that increases it pulls Gaussians of the background's colour over the object's edge.
        """
        covered = None if self.alpha is None else self.alpha > SOLID
        if covered is None or self.trained is None:
            return self.trained if covered is None else covered
        return covered & self.trained

    @property
    def trained(self) -> Tensor | None:
        """`[H, W]` bool, pixels of full weight in training; None where all are."""
        return None if self.weights is None else self.weights == 1

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
        depth: `[H, W]` float32 true z-depth, 0 where unknown; None if the data set has no depth.
    """

    depth: Tensor | None = None

    def for_training(self) -> TrainingView:
        """Return the view without true depth, and without the colours of pixels of weight 0."""
        image = self.image if self.weights is None else self._known_colors
        return TrainingView(self.name, self.camera, image, self.mask, self.alpha, self.weights)

    @cached_property
    def _known_colors(self) -> Tensor:
        """The image; pixels of weight 0 have the colour of the nearest other pixel.

        So no component, blur or reduced copy can learn what was excluded.
        """
        from scipy.ndimage import distance_transform_edt  # type: ignore[attr-defined]

        assert self.weights is not None
        excluded = (self.weights == 0).numpy()
        row, column = distance_transform_edt(excluded, return_distances=False, return_indices=True)
        return self.image[row, column]


@dataclass(frozen=True, eq=False)
class TrainingScene:
    """The part of a scene that initializers and training may use: no test views, no true depth.

    Args:
        name, bounds, points, background, frame: as in `Scene`.
        train: the training views; at least one.
    """

    name: str
    train: tuple[TrainingView, ...]
    bounds: tuple[float, float]
    points: PointCloud | None = None
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    frame: Frame = IN_FILE

    @property
    def extent(self) -> float:
        """Extent of the training cameras (`camera_extent`), world units.

        0.1 times the far bound for a single camera, or cameras at one place: learning rates must not vanish.
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
        name: for titles, tables and messages.
        train: the views to train on; at least one.
        test: the views that are rendered and scored; may be empty.
        bounds: (near, far) z-depth of the scene's content in world units, 0 < near < far.
        points: sparse points that were computed from the training views only, or None.
        background: colour behind the scene, three numbers in [0, 1].
        facts: recorded in the results, for example where photographs come from and how they were changed
            and split.
        frame: origin and unit of these coordinates in the file; the identity in a scene from a loader.
    """

    name: str
    train: tuple[View, ...]
    test: tuple[View, ...]
    bounds: tuple[float, float]
    points: PointCloud | None = None
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    facts: tuple[Fact, ...] = ()
    frame: Frame = IN_FILE

    @property
    def extent(self) -> float:
        """`TrainingScene.extent`, world units."""
        return self.for_training().extent

    def for_training(self) -> TrainingScene:
        """Return the part that components may use before evaluation."""
        views = tuple(view.for_training() for view in self.train)
        return TrainingScene(
            self.name, views, self.bounds, self.points, self.background, self.frame
        )

    def in_frame(self, frame: Frame | None = None) -> Scene:
        """Return the scene of a file in another frame, for training; None: `Frame.of` this scene."""
        if frame is None:
            frame = Frame.of([view.camera for view in self.train], self.bounds)
        unit, points = frame.unit, self.points
        near, far = self.bounds
        return replace(
            self,
            train=tuple(_in_frame(view, frame) for view in self.train),
            test=tuple(_in_frame(view, frame) for view in self.test),
            bounds=(near / unit, far / unit),
            points=None
            if points is None
            else replace(
                points,
                positions=frame.points_of_file(points.positions),
                scales=None if points.scales is None else points.scales / unit,
                maps={name: replace(m, depth=m.depth / unit) for name, m in points.maps.items()},
            ),
            frame=frame,
        )

    def fact(self, name: str) -> FactValue:
        """Return the value of a fact; raise KeyError if there is none of that name."""
        return {fact.name: fact.value for fact in self.facts}[name]


def _in_frame(view: View, frame: Frame) -> View:
    depth = None if view.depth is None else view.depth / frame.unit
    return replace(view, camera=frame.camera_of_file(view.camera), depth=depth)


@dataclass(frozen=True, eq=False)
class Disparity:
    """Disparity of a rectified pair on the pixels of one of its images.

    Args:
        values: `[H, W]` float32 pixels, > 0 where valid and 0 elsewhere. The left image's pixel
            (u, v) shows what the right image shows at (u - values[v, u], v).
        valid: `[H, W]` bool.
    """

    values: Tensor
    valid: Tensor


@dataclass(frozen=True, eq=False)
class DepthMap:
    """A view's depth.

    Args:
        depth: `[H, W]` float32 z-depth in world units, > 0 where valid and 0 elsewhere.
        valid: `[H, W]` bool.
        confidence: `[H, W]` float32 in [0, 1]; 0 where not valid.
    """

    depth: Tensor
    valid: Tensor
    confidence: Tensor


@dataclass(frozen=True, eq=False)
class Flow:
    """Optical flow from one image to another.

    Args:
        vectors: `[H, W, 2]` float32 pixels (along columns, along rows); 0 where not valid. Pixel (u, v)
            of the first image corresponds to (u, v) + vectors[v, u] in the second.
        valid: `[H, W]` bool.
    """

    vectors: Tensor
    valid: Tensor


@dataclass(frozen=True, eq=False)
class Matches:
    """Corresponding points of two images.

    Args:
        first, second: `[M, 2]` float32 pixel positions (column, row) in the first and in the second
            image; the centre of the first pixel is (0.5, 0.5).
        scores: `[M]` float32 in [0, 1], confidence of each match.
    """

    first: Tensor
    second: Tensor
    scores: Tensor
