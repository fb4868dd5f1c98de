"""What prior models can be asked, one file a capability, and the one place where answers are checked.

A prior plugin derives from one of these classes and implements `estimate`. Consumers call the public
methods beside it, which check sizes and values, so that no NaN ever reaches a loss or a point cloud.
What is asked of a scene's *views* is answered from the disk cache where the same was asked before; what
is asked of *images*, renders among them, is not kept.
"""

from typing import TYPE_CHECKING

from core_rasterizer.first_use import names_on_first_use

if TYPE_CHECKING:
    from ..contract.maps import DepthMap, Disparity, Flow, Matches
    from .matching import MatchingPrior
    from .monocular_depth import MonocularDepthPrior
    from .multi_view_depth import MultiViewDepthPrior
    from .optical_flow import OpticalFlowPrior
    from .stereo import StereoPrior
else:
    __getattr__, __dir__ = names_on_first_use(__name__)

__all__ = [
    "DepthMap",
    "Disparity",
    "Flow",
    "Matches",
    "MatchingPrior",
    "MonocularDepthPrior",
    "MultiViewDepthPrior",
    "OpticalFlowPrior",
    "StereoPrior",
]
