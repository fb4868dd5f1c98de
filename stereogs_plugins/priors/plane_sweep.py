"""`plane_sweep`: depth of posed views by classical matching over planes; needs no model file.

For each view, planes parallel to its image are swept through the scene; every other view, warped over a
plane, matches where the plane passes through the surface. Costs are aggregated semi-globally and the
cheapest plane is refined between its neighbours.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

from pydantic import Field, model_validator

from core_rasterizer.matching import LARGEST_PENALTY, MAX_SWEEP_RADIUS
from registry import Context, PluginError, Register, Settings, TrainingView, hookimpl
from registry.priors import DepthMap, MultiViewDepthPrior
from registry.toolkit.drawing import grey
from registry.toolkit.networks import OnnxModel, Sha256

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from torch import Tensor

    from core_rasterizer import Camera
    from core_rasterizer.matching import FeatureSweep, ZnccSweep


class PlaneSweepSettings(Settings):
    planes: int = Field(192, ge=4, le=1024)
    """How many planes, equally spaced in inverse depth."""
    near_margin: float = Field(0.9, gt=0, le=1)
    """The nearest plane lies at so many times the scene's near bound."""
    far_margin: float = Field(1.2, ge=1, allow_inf_nan=False)
    """The farthest plane lies at so many times the scene's far bound."""
    max_sources: int = Field(6, ge=1, le=16)
    """Each view is compared with so many others at most: those that see the same under a good angle."""
    cost: Literal["zncc", "features"] = "zncc"
    """How pixels are compared: correlation of grey windows, or learned features from a file."""
    radius: int = Field(2, ge=1, le=MAX_SWEEP_RADIUS)
    """Radius of the windows of `zncc`, pixels."""
    features: Path | None = None
    """For `features`: a local ONNX file of the form of MC-CNN fast."""
    sha256: Sha256 | None = None
    """The hash that the file must have; null takes any file."""
    second_share: float = Field(0.25, ge=0, le=1)
    """Weight of the view that matches second best; the best has the rest, since others may be hidden."""
    small_penalty: int = Field(10, ge=0, le=LARGEST_PENALTY)
    """Cost of a step to the next plane between two pixels (P1); a match costs 0 to 255."""
    large_penalty: int = Field(4000, ge=0, le=LARGEST_PENALTY)
    """Cost of a larger step (P2); it is divided by the difference of the two grey levels."""

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if (self.cost == "features") != (self.features is not None):
            raise ValueError("`cost: features` and a file in `features` go together")
        if self.large_penalty < self.small_penalty:
            raise ValueError("`large_penalty` must be at least `small_penalty`")
        return self


class PlaneSweep(MultiViewDepthPrior[PlaneSweepSettings]):
    """Plane sweep, semi-global aggregation, the cheapest plane.

    Raises:
        PluginError: the file of features cannot be used, see `LearnedFeatures`.
    """

    def __init__(self, settings: PlaneSweepSettings, context: Context) -> None:
        from registry.toolkit.networks import LearnedFeatures

        super().__init__(settings, context)
        self._features = (
            LearnedFeatures(settings.features, settings.sha256) if settings.features else None
        )

    @classmethod
    def settings_for(cls, model: OnnxModel) -> Sequence[Mapping[str, Any]]:
        """The cost `features`, for a file of learned features."""
        from registry.toolkit.networks import LearnedFeatures

        if not LearnedFeatures.recognizes(model):
            return []
        return [{"cost": "features", "features": str(model.path), "sha256": model.sha256}]

    def fingerprint(self) -> str:
        """The device, since another may round a sample differently, and the file of features."""
        device = self.context.device
        model = self._features.fingerprint if self._features else ""
        return f"{device.platform} {device.name} {device.driver} {device.variant} {model}"

    def estimate(
        self, views: Sequence[TrainingView], bounds: tuple[float, float]
    ) -> list[DepthMap]:
        """Return one depth map for each view.

        A depth is valid where the point projects into another view that it was compared with. No view
        was asked whether it agrees: that is for whoever needs to know.

        Raises:
            PluginError: all cameras stand in one place.
            MemoryBudgetError: a view's cost volume would take more than half of the device's memory.
        """
        import torch

        from core_rasterizer.matching import Penalties, aggregate, pick, seen_by_any

        planes = self.settings.planes
        near, far = bounds[0] * self.settings.near_margin, bounds[1] * self.settings.far_margin
        farthest, step = 1 / far, (1 / near - 1 / far) / (planes - 1)
        inverse_depths = farthest + step * torch.arange(planes, dtype=torch.float64)
        cameras = [view.camera for view in views]
        greys = [grey(view.image) for view in views]
        sweep = self._sweep(views, greys, inverse_depths)
        penalties = Penalties(self.settings.small_penalty, self.settings.large_penalty)
        maps = []
        for index, camera in enumerate(cameras):
            sources = _sources(cameras, index, self.settings.max_sources, (near, far))
            costs = sweep.costs(index, sources)
            sums = aggregate(self.context.device, costs, greys[index], penalties)
            plane, confidence = pick(self.context.device, sums, planes)
            depth = 1 / (farthest + step * plane.double())
            valid = seen_by_any(depth, camera, [cameras[k] for k in sources])
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


def _sources(
    cameras: Sequence[Camera], reference: int, count: int, bounds: tuple[float, float]
) -> list[int]:
    """The views to compare one of them with, without those that stand in the same place."""
    from core_rasterizer.matching import source_views

    sources = source_views(cameras, reference, count, bounds)
    if not sources:
        raise PluginError(
            f"the {len(cameras)} cameras stand in one place, from where no depth can be seen",
            fix="use views from different places, or check the poses",
        )
    return sources


@hookimpl
def stereogs_register_priors(register: Register[PlaneSweep]) -> None:
    register("plane_sweep", PlaneSweep)
