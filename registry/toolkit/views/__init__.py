"""Geometry of views: epipolar distances, flow consistency, angles, values of Gaussians rendered.

    from registry.toolkit.views import epipolar_distances, virtual_views

    kept = epipolar_distances(matches, first.camera, second.camera) < 2
    camera = virtual_views.draw("between", scene, generator)

The modules `virtual_views` and `triangulation` are public too.
"""

from typing import TYPE_CHECKING

from core_rasterizer.first_use import names_on_first_use

if TYPE_CHECKING:
    from ...contract.scene import SOLID
    from .confident_gaussians import confidence_of_gaussians
    from .correspondences import epipolar_distances, flow_cycle_error, flow_in_size
    from .painted import Painted, gathered, same_model
    from .predicted_error import RIGHT, decibels, predicted_psnr
    from .scene_facts import image_sizes, points_in_view, summary, warnings
    from .view_parameters import ViewParameters
    from .viewing_angles import ViewAngles, subject_of, view_angles
    from .where_to_stand import Photographs, words_between
else:
    __getattr__, __dir__ = names_on_first_use(__name__)

__all__ = [
    "RIGHT",
    "SOLID",
    "Painted",
    "Photographs",
    "ViewAngles",
    "ViewParameters",
    "confidence_of_gaussians",
    "decibels",
    "epipolar_distances",
    "flow_cycle_error",
    "flow_in_size",
    "gathered",
    "image_sizes",
    "points_in_view",
    "predicted_psnr",
    "same_model",
    "subject_of",
    "summary",
    "view_angles",
    "warnings",
    "words_between",
]
