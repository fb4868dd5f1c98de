"""Dense matching on a device: cost volumes, semi-global aggregation, plane sweeps, PatchMatch."""

from typing import TYPE_CHECKING

from ..first_use import names_on_first_use

if TYPE_CHECKING:
    from .feature_sweep import FeatureSweep
    from .limits import MAX_PATCH_SOURCES, MAX_PENALTY, MAX_RADIUS, MAX_SWEEP_RADIUS
    from .patch_match import PatchMatch
    from .plane_sweep import ZnccSweep
    from .rectified import census_costs, feature_costs, right_costs, zncc_costs
    from .semi_global import CostVolume, Penalties, aggregate, pick
    from .sweep_geometry import seen_by_any
    from .view_selection import source_views
else:
    __getattr__, __dir__ = names_on_first_use(__name__)

__all__ = [
    "MAX_PATCH_SOURCES",
    "MAX_PENALTY",
    "MAX_RADIUS",
    "MAX_SWEEP_RADIUS",
    "CostVolume",
    "FeatureSweep",
    "PatchMatch",
    "Penalties",
    "ZnccSweep",
    "aggregate",
    "census_costs",
    "feature_costs",
    "pick",
    "right_costs",
    "seen_by_any",
    "source_views",
    "zncc_costs",
]
