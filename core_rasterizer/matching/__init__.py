"""Dense matching on a device: cost volumes, semi-global aggregation, plane sweeps, PatchMatch."""

from typing import TYPE_CHECKING

from ..first_use import names_on_first_use

if TYPE_CHECKING:
    from .feature_sweep import FeatureSweep as FeatureSweep
    from .limits import (
        MAX_PATCH_SOURCES as MAX_PATCH_SOURCES,
        MAX_PENALTY as MAX_PENALTY,
        MAX_RADIUS as MAX_RADIUS,
        MAX_SWEEP_RADIUS as MAX_SWEEP_RADIUS,
    )
    from .patch_match import PatchMatch as PatchMatch
    from .plane_sweep import ZnccSweep as ZnccSweep
    from .rectified import (
        census_costs as census_costs,
        feature_costs as feature_costs,
        right_costs as right_costs,
        zncc_costs as zncc_costs,
    )
    from .semi_global import (
        CostVolume as CostVolume,
        Penalties as Penalties,
        aggregate as aggregate,
        pick as pick,
    )
    from .sweep_geometry import seen_by_any as seen_by_any
    from .view_selection import source_views as source_views
else:
    __all__, __dir__, __getattr__ = names_on_first_use(__name__)
