"""Points from pairs of photographs with known cameras: `flow_epipolar` and `matched_points`.

`flow_epipolar`: a point for every pixel whose optical flow stays near its epipolar line (NexusGS, Zheng et
al., CVPR 2025). Flow to the nearest cameras is moved onto the epipolar lines of the known poses, and depth is
triangulated. The authors use a flow network.

`matched_points`: a point for every match between two training photographs that fits their cameras, as in
Binocular3DGS (Han et al. 2024), whose authors use a dense matching network.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field

from registry import (
    Initializer,
    PointCloud,
    Prior,
    Register,
    SceneError,
    Settings,
    TrainingScene,
    hookimpl,
)
from registry.priors import DepthMap, MatchingPrior, OpticalFlowPrior
from registry.toolkit.progress import tracked

if TYPE_CHECKING:
    from collections.abc import Mapping

    from torch import Tensor

    from core_rasterizer import Camera
    from registry import TrainingView

BOUNDS_MARGIN = 1.1
"""Depths outside near / margin to far * margin come from wrong correspondences."""
STEP = 0.5
"""Step along the epipolar line for measuring the sensitivity, pixels."""


class FlowEpipolarSettings(Settings):
    prior: str | None = None
    """Name of the optical-flow prior; null takes the only one."""
    neighbours: int = Field(2, ge=1)
    """Number of nearest training cameras that each view is compared with."""
    max_distance: float = Field(1.0, gt=0)
    """Largest distance of the flow from the epipolar line, pixels."""
    blend: Literal["nearest_valid", "min_sensitivity"] = "nearest_valid"
    """Depth of a pixel: from the nearest camera with a valid one (as in the authors' code), or the one that
    changes least with an error of the flow (as in the paper)."""
    stride: int = Field(1, ge=1)
    """One point per square of this many by this many pixels."""


class FlowEpipolar(Initializer[FlowEpipolarSettings]):
    """Points from optical flow and known cameras; also returns depth maps (`PointCloud.maps`)."""

    ablation_baseline = "sfm"
    needs_priors = ("optical_flow",)

    def initialize(self, scene: TrainingScene, priors: Mapping[str, Prior[Any]]) -> PointCloud:
        """Return at least one point, and each view's depth.

        Raises:
            PluginError: the pipeline has no optical-flow prior, or several and `prior` is null.
            SceneError: one training view, or no flow fits the cameras.
        """
        prior = OpticalFlowPrior.choose(priors, self.settings.prior)
        if len(scene.train) < 2:
            raise SceneError(
                "flow needs two training views, but the scene has one",
                where=scene.name,
                fix="use two or more training views, or the initializer `random`",
            )
        maps = {view.name: self._map(view, scene, prior) for view in tracked(scene.train, "depth")}
        if not any(known.valid.any() for known in maps.values()):
            raise SceneError(
                f"no flow between the {len(maps)} training views fits their cameras",
                where=scene.name,
                fix="check the poses, raise `max_distance`, or use the initializer `sfm`",
            )
        return self._points(scene, maps)

    def _map(
        self, view: TrainingView, scene: TrainingScene, prior: OpticalFlowPrior[Any]
    ) -> DepthMap:
        """Depth of one view, blended over its neighbours."""
        import torch

        depth = torch.zeros(view.image.shape[:2], dtype=torch.float64)
        best = torch.full_like(depth, torch.inf)
        for other in _nearest(view, scene)[: self.settings.neighbours]:
            candidate, sensitivity = self._candidate(view, other, scene, prior)
            better = candidate > 0
            if self.settings.blend == "nearest_valid":
                better &= depth == 0
            else:
                better &= sensitivity < best
            depth, best = candidate.where(better, depth), sensitivity.where(better, best)
        valid = depth > 0
        return DepthMap(depth.float(), valid, valid.float())

    def _candidate(
        self,
        view: TrainingView,
        other: TrainingView,
        scene: TrainingScene,
        prior: OpticalFlowPrior[Any],
    ) -> tuple[Tensor, Tensor]:
        """Depth `[H, W]` from the flow to one neighbour, 0 where unknown, and its sensitivity."""
        import torch

        flow = prior.flow_between(view, other)
        here = torch.stack(view.camera.pixel_centers(), dim=2)
        there = here + flow.vectors
        found = intersect(view.camera, other.camera, here.flatten(0, 1), there.flatten(0, 1))
        size = there.new_tensor([other.camera.width, other.camera.height])
        kept = flow.valid & ((there >= 0) & (there <= size)).all(dim=2)
        kept &= (found.distance < self.settings.max_distance).reshape(kept.shape)
        kept &= within_bounds(found.depth, scene).reshape(kept.shape)
        if view.trained is not None:
            kept &= view.trained
        depth = found.depth.reshape(kept.shape).where(kept, 0.0)
        return depth, found.sensitivity.reshape(kept.shape).nan_to_num(torch.inf)

    def _points(self, scene: TrainingScene, maps: Mapping[str, DepthMap]) -> PointCloud:
        import torch

        from registry.toolkit.drawing import nearness_picture

        positions, colors, pictures = [], [], {}
        stride = self.settings.stride
        for view in scene.train:
            known = maps[view.name]
            chosen = torch.zeros_like(known.valid)
            chosen[stride // 2 :: stride, stride // 2 :: stride] = True
            chosen &= known.valid
            u, v = view.camera.pixel_centers()
            positions.append(view.camera.unproject(u[chosen], v[chosen], known.depth[chosen]))
            colors.append(view.image[chosen])
            pictures[f"{view.name.removesuffix('.png')}_depth"] = nearness_picture(
                1 / known.depth.where(known.valid, 1.0), known.valid
            )
        return PointCloud(
            positions=torch.cat(positions).float(),
            colors=torch.cat(colors),
            facts={
                "known": {name: round(float(m.valid.float().mean()), 4) for name, m in maps.items()}
            },
            pictures=pictures,
            maps=maps,
        )


def _nearest(view: TrainingView, scene: TrainingScene) -> list[TrainingView]:
    """The other training views, nearest camera first."""
    others = [other for other in scene.train if other is not view]
    return sorted(
        others, key=lambda other: float((other.camera.center - view.camera.center).norm())
    )


class MatchedPointsSettings(Settings):
    prior: str | None = None
    """Name of the matching prior; null takes the only one."""
    max_distance: float = Field(2.0, gt=0)
    """Largest distance of a match from its epipolar line, pixels."""
    min_score: float = Field(0.0, ge=0, le=1)
    """Drop matches with a lower score."""


class MatchedPoints(Initializer[MatchedPointsSettings]):
    """Triangulated matches, each first moved onto its epipolar line."""

    ablation_baseline = "sfm"
    needs_priors = ("matches",)

    def initialize(self, scene: TrainingScene, priors: Mapping[str, Prior[Any]]) -> PointCloud:
        """Return at least one point.

        Raises:
            PluginError: the pipeline has no matching prior, or several and `prior` is null.
            SceneError: no match between two training views fits their cameras.
        """
        import torch

        prior = MatchingPrior.choose(priors, self.settings.prior)
        pairs = list(combinations(scene.train, 2))
        found = [self._pair(*pair, scene, prior) for pair in tracked(pairs, "matching")]
        counts = [len(positions) for positions, _ in found]
        if not any(counts):
            raise SceneError(
                f"no match between the {len(scene.train)} training views fits their cameras",
                where=scene.name,
                fix="use training views that overlap, check the poses, raise `max_distance`, or use the "
                "initializer `random`",
            )
        return PointCloud(
            positions=torch.cat([positions for positions, _ in found]).float(),
            colors=torch.cat([colors for _, colors in found]),
            facts={"points_by_pair": counts},
        )

    def _pair(
        self,
        first: TrainingView,
        second: TrainingView,
        scene: TrainingScene,
        prior: MatchingPrior[Any],
    ) -> tuple[Tensor, Tensor]:
        """Positions `[P, 3]` and colours `[P, 3]` from one pair of views."""
        matches = prior.matches_between(first, second)
        found = intersect(first.camera, second.camera, matches.first, matches.second)
        kept = (found.distance < self.settings.max_distance) & within_bounds(found.depth, scene)
        kept &= matches.scores >= self.settings.min_score
        height, width = first.image.shape[:2]
        u, v = matches.first.unbind(dim=1)
        row, column = v.long().clamp(max=height - 1), u.long().clamp(max=width - 1)
        if first.trained is not None:
            kept &= first.trained[row, column]
        colors = first.image[row[kept], column[kept]]
        return first.camera.unproject(u[kept], v[kept], found.depth[kept]), colors


@dataclass(frozen=True, eq=False)
class Intersection:
    """Results for P correspondences.

    Args:
        depth: `[P]` float64 z-depth in the first camera, world units; NaN where the rays do not meet in
            front of both cameras.
        distance: `[P]` float64 distance of the second position from the epipolar line of the first, pixels.
        sensitivity: `[P]` float64 change of depth per pixel along that line; not finite where depth is
            unknown.
    """

    depth: Tensor
    distance: Tensor
    sensitivity: Tensor


def intersect(first: Camera, second: Camera, here: Tensor, there: Tensor) -> Intersection:
    """Intersect rays of the first camera with those of the second.

    A second position is first moved to the nearest point of its epipolar line, so that both rays lie in
    one plane.

    Args:
        here, there: `[P, 2]` columns and rows in the first and in the second image, pixels.
    """
    import torch

    relative = second.world_to_camera @ first.camera_to_world
    shift = relative[:3, 3]
    rays = _homogeneous(here) @ torch.linalg.inv(first.intrinsics).T @ relative[:3, :3].T
    back = torch.linalg.inv(second.intrinsics)
    # Epipolar lines: the plane of a ray and both centres, in the second image.
    lines = torch.linalg.cross(shift.expand_as(rays), rays) @ back
    normals = lines[:, :2] / lines[:, :2].norm(dim=1, keepdim=True)
    signed = (_homogeneous(there) * lines).sum(1) / lines[:, :2].norm(dim=1)
    feet = there.double() - signed[:, None] * normals
    along = torch.stack([-normals[:, 1], normals[:, 0]], dim=1)
    depths = [
        _meeting(rays, shift, _homogeneous(feet + offset * along) @ back.T)
        for offset in (0.0, STEP, -STEP)
    ]
    return Intersection(depths[0], signed.abs(), (depths[1] - depths[2]).abs() / (2 * STEP))


def within_bounds(depth: Tensor, scene: TrainingScene) -> Tensor:
    """Mask of depths that can be the scene's content."""
    near, far = scene.bounds
    inside: Tensor = (depth > near / BOUNDS_MARGIN) & (depth < far * BOUNDS_MARGIN)
    return inside


def _meeting(rays: Tensor, shift: Tensor, directions: Tensor) -> Tensor:
    """The z with z * ray + shift parallel to a direction, in the second camera; NaN if none."""
    import torch

    moved = torch.linalg.cross(shift.expand_as(directions), directions)
    turned = torch.linalg.cross(rays, directions)
    z = -(moved * turned).sum(1) / turned.square().sum(1)
    in_front = (z > 0) & (z * rays[:, 2] + shift[2] > 0)
    depth: Tensor = z.where(in_front, torch.nan)
    return depth


def _homogeneous(pixels: Tensor) -> Tensor:
    from torch.nn.functional import pad

    return pad(pixels.double(), (0, 1), value=1.0)


@hookimpl
def stereogs_register_initializers(register: Register[FlowEpipolar | MatchedPoints]) -> None:
    register("flow_epipolar", FlowEpipolar)
    register("matched_points", MatchedPoints)
