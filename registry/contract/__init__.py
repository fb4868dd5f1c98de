"""Base classes and data types of plugins. `registry` exports those that most plugins need."""

from typing import TYPE_CHECKING

from core_rasterizer.first_use import names_on_first_use

if TYPE_CHECKING:
    from .components import AverageErrorRole
    from .hook_points import HOOK_POINTS, PIPELINE_POINTS, STAGES, HookPoint
    from .prior import usable_priors
    from .scene import SOLID, camera_extent
else:
    __getattr__, __dir__ = names_on_first_use(__name__)

__all__ = [
    "HOOK_POINTS",
    "PIPELINE_POINTS",
    "SOLID",
    "STAGES",
    "AverageErrorRole",
    "HookPoint",
    "camera_extent",
    "usable_priors",
]
