"""`plane_sweep`: depth of posed views by plane sweep; needs no model file.

Planes parallel to each view's image are swept through the scene; source views warped over a plane match
where it intersects the surface. Costs are aggregated semi-globally, and the cheapest plane is refined
between its neighbours.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from core_rasterizer.matching import MAX_PENALTY, MAX_SWEEP_RADIUS
from registry import Context, PluginError, Register, Settings, TrainingView, hookimpl
from registry.priors import DepthMap, MultiViewDepthPrior
from registry.toolkit.images import grey
from registry.toolkit.networks import OnnxModel, Sha256
from registry.toolkit.progress import tracked

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from torch import Tensor

    from core_rasterizer.matching import FeatureSweep, ZnccSweep

NEAR_MARGIN, FAR_MARGIN = 0.9, 1.2
"""Least and largest depth as multiples of the scene's near and far bound."""


class PlaneSweepSettings(Settings):
    removed: ClassVar = {"near_margin": NEAR_MARGIN, "far_margin": FAR_MARGIN}
    planes: int = Field(192, ge=4, le=1024)
    """Number of planes, equally spaced in inverse depth."""
    max_sources: int = Field(6, ge=1, le=16)
    """Largest number of source views per view, chosen by overlap and triangulation angle."""
    cost: Literal["zncc", "features"] = "zncc"
    """Matching cost: correlation of grey windows, or learned features from a file."""
    radius: int = Field(2, ge=1, le=MAX_SWEEP_RADIUS)
    """Radius of the windows of `zncc`, pixels."""
    features: Path | None = None
    """For `features`: path of an ONNX file in the format of MC-CNN fast."""
    sha256: Sha256 | None = None
    """Required hash of the file; null accepts any file."""
    second_share: float = Field(0.25, ge=0, le=1)
    """Weight of the source view with the second lowest cost; the lowest has the rest. Other views are
    ignored because they may be occluded."""
    small_penalty: int = Field(10, ge=0, le=MAX_PENALTY)
    """Penalty P1 for a step of one plane between two pixels; a match costs 0 to 255."""
    large_penalty: int = Field(4000, ge=0, le=MAX_PENALTY)
    """Penalty P2 for a larger step; it is divided by the difference of the two grey levels."""

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if (self.cost == "features") != (self.features is not None):
            raise ValueError("`cost: features` and a file in `features` require each other")
        if self.large_penalty < self.small_penalty:
            raise ValueError("`large_penalty` must be at least `small_penalty`")
        return self


class PlaneSweep(MultiViewDepthPrior[PlaneSweepSettings]):
    """Plane sweep with semi-global aggregation.

    Raises:
        PluginError: the file in `features` cannot be used, see `LearnedFeatures`.
    """

    def __init__(self, settings: PlaneSweepSettings, context: Context) -> None:
        from registry.toolkit.networks import LearnedFeatures

        super().__init__(settings, context)
        self._features = (
            LearnedFeatures(settings.features, settings.sha256) if settings.features else None
        )

    @classmethod
    def settings_for(cls, model: OnnxModel) -> Sequence[Mapping[str, Any]]:
        """The cost `features`, for a file with learned features."""
        from registry.toolkit.networks import LearnedFeatures

        if not LearnedFeatures.recognizes(model):
            return []
        return [{"cost": "features", "features": str(model.path), "sha256": model.sha256}]

    def fingerprint(self) -> str:
        """The device, as another one may round differently, and the file in `features`."""
        device = self.context.device
        model = self._features.fingerprint if self._features else ""
        return f"{device.platform} {device.name} {device.driver} {device.variant} {model}"

    def estimate(
        self, views: Sequence[TrainingView], bounds: tuple[float, float]
    ) -> list[DepthMap]:
        """Return one depth map for each view.

        A depth is valid where the point projects into a source view; consistency between views is not
        checked.

        Raises:
            PluginError: all cameras are at the same position.
            MemoryBudgetError: a view's cost volume needs more than half of the device's memory.
        """
        import torch

        from core_rasterizer.matching import Penalties, aggregate, pick, seen_by_any, source_views

        planes = self.settings.planes
        near, far = bounds[0] * NEAR_MARGIN, bounds[1] * FAR_MARGIN
        farthest, step = 1 / far, (1 / near - 1 / far) / (planes - 1)
        inverse_depths = farthest + step * torch.arange(planes, dtype=torch.float64)
        cameras = [view.camera for view in views]
        sources = source_views(cameras, self.settings.max_sources, (near, far))
        if not all(sources):
            raise PluginError(
                f"the {len(cameras)} cameras are at the same position, so depth cannot be estimated",
                fix="use views from different positions, or check the poses",
            )
        greys = [grey(view.image) for view in views]
        sweep = self._sweep(views, greys, inverse_depths)
        penalties = Penalties(self.settings.small_penalty, self.settings.large_penalty)
        maps = []
        for index, camera in enumerate(tracked(cameras, "depth")):
            costs = sweep.costs(index, sources[index])
            sums = aggregate(self.context.device, costs, greys[index], penalties)
            plane, confidence = pick(self.context.device, sums, planes)
            depth = 1 / (farthest + step * plane.double())
            valid = seen_by_any(depth, camera, [cameras[k] for k in sources[index]])
            maps.append(DepthMap(depth.float(), valid, confidence))
        return maps

    def _sweep(
        self, views: Sequence[TrainingView], greys: Sequence[Tensor], inverse_depths: Tensor
    ) -> ZnccSweep | FeatureSweep:
        from core_rasterizer.matching import FeatureSweep, ZnccSweep

        device, share = self.context.device, self.settings.second_share
        cameras = [view.camera for view in views]
        if self._features:
            features = [self._features(view.image) for view in views]
            return FeatureSweep(device, features, cameras, inverse_depths, second_share=share)
        radius = self.settings.radius
        return ZnccSweep(device, greys, cameras, inverse_depths, radius=radius, second_share=share)


@hookimpl
def stereogs_register_priors(register: Register[PlaneSweep]) -> None:
    register("plane_sweep", PlaneSweep)
