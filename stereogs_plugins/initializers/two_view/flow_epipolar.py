"""`flow_epipolar`: a point for every pixel whose optical flow keeps to its epipolar line (NexusGS).

Zheng et al., CVPR 2025: flow to the nearest cameras is moved onto the epipolar lines that known poses
give, and depth follows from where the rays meet. The authors ask a flow network.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field

from registry import Initializer, PointCloud, Prior, SceneError, Settings, TrainingScene
from registry.priors import DepthMap, OpticalFlowPrior

if TYPE_CHECKING:
    from collections.abc import Mapping

    from torch import Tensor

    from registry import TrainingView


class FlowEpipolarSettings(Settings):
    prior: str | None = None
    """Name of the optical-flow prior; null takes the only one."""
    neighbours: int = Field(2, ge=1)
    """How many of the nearest training cameras each view is compared with."""
    max_distance: float = Field(1.0, gt=0)
    """Pixels by which the flow may miss the epipolar line."""
    blend: Literal["nearest_valid", "min_sensitivity"] = "nearest_valid"
    """Which neighbour's depth a pixel takes: that of the nearest camera that gives one (what the authors'
    code does), or that which moves least with an error of the flow (what the paper says)."""
    stride: int = Field(1, ge=1)
    """One point for each square of so many by so many pixels."""


class FlowEpipolar(Initializer[FlowEpipolarSettings]):
    """Points from optical flow and known cameras; hands its depths on (`PointCloud.maps`)."""

    ablation_baseline = "sfm"
    needs_priors = ("optical_flow",)

    def initialize(self, scene: TrainingScene, priors: Mapping[str, Prior[Any]]) -> PointCloud:
        """Return at least one point, and each view's depth.

        Raises:
            PluginError: the pipeline has no optical-flow prior, or several and `prior` is null.
            SceneError: one training view, or no flow that fits the cameras.
        """
        prior = OpticalFlowPrior.choose(priors, self.settings.prior)
        if len(scene.train) < 2:
            raise SceneError(
                "flow needs two training views, there is one",
                where=scene.name,
                fix="use two or more training views, or the initializer `random`",
            )
        maps = {view.name: self._map(view, scene, prior) for view in scene.train}
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
        """The depth of one view, blended over its neighbours."""
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
        """Depth `[H, W]`, 0 where unknown, and its sensitivity, by the flow to one neighbour."""
        import torch

        from .epipolar import intersect, within_bounds

        flow = prior.flow_between(view, other)
        here = torch.stack(view.camera.pixel_centers(), dim=2)
        there = here + flow.vectors
        found = intersect(view.camera, other.camera, here.flatten(0, 1), there.flatten(0, 1))
        size = there.new_tensor([other.camera.width, other.camera.height])
        kept = flow.valid & ((there >= 0) & (there <= size)).all(dim=2)
        kept &= (found.distance < self.settings.max_distance).reshape(kept.shape)
        kept &= within_bounds(found.depth, scene).reshape(kept.shape)
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
    """The other training views, the nearest camera first."""
    others = [other for other in scene.train if other is not view]
    return sorted(
        others, key=lambda other: float((other.camera.center - view.camera.center).norm())
    )
