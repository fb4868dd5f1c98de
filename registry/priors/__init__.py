"""Capabilities of priors: one base class per kind of estimate.

    class Mine(MonocularDepthPrior[MySettings]):
        def estimate(self, image): ...          returns MonocularDepth, or [H, W] inverse depth

    depth = prior.depth_of(view)                in the plugin that uses the prior

A prior plugin derives from one of these classes and implements `estimate`. Consumers call the other public
methods. These check shapes and values, so that no NaN reaches a loss or a point cloud. Estimates for the
*views* of a scene are cached on disk; estimates for *images*, for example renders, are not.
"""

from typing import TYPE_CHECKING

from core_rasterizer.first_use import names_on_first_use

if TYPE_CHECKING:
    from ..contract.scene import (
        DepthMap as DepthMap,
        Disparity as Disparity,
        Flow as Flow,
        Matches as Matches,
    )
    from .capabilities import (
        MatchingPrior as MatchingPrior,
        MultiViewDepthPrior as MultiViewDepthPrior,
        OpticalFlowPrior as OpticalFlowPrior,
        StereoPrior as StereoPrior,
    )
    from .gaussians import GaussiansPrior as GaussiansPrior
    from .masks import MaskPrior as MaskPrior
    from .monocular_depth import (
        MonocularDepth as MonocularDepth,
        MonocularDepthPrior as MonocularDepthPrior,
    )
    from .normals import NormalPrior as NormalPrior
    from .posed_depth import PosedDepth as PosedDepth, PosedDepthPrior as PosedDepthPrior
    from .prior_cache import cached as cached, identity as identity
else:
    __all__, __dir__, __getattr__ = names_on_first_use(__name__)
