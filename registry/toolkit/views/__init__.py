"""Geometry of views: epipolar distances, flow consistency, parameters per training view."""

from typing import TYPE_CHECKING

from core_rasterizer.first_use import names_on_first_use

if TYPE_CHECKING:
    from .epipolar import epipolar_distances
    from .flow_geometry import flow_cycle_error, flow_in_size
    from .view_parameters import ViewParameters
else:
    __getattr__, __dir__ = names_on_first_use(__name__)

__all__ = ["ViewParameters", "epipolar_distances", "flow_cycle_error", "flow_in_size"]
