"""Geometry of views: epipolar distances, flow consistency, overlap, angles, values of Gaussians rendered.

    from registry.toolkit.views import epipolar_distances, virtual_views

    kept = epipolar_distances(matches, first.camera, second.camera) < 2
    camera = virtual_views.draw("between", scene, generator)

The modules `virtual_views` and `triangulation` are public too.
"""

from typing import TYPE_CHECKING

from core_rasterizer.first_use import names_on_first_use

if TYPE_CHECKING:
    from ...contract.scene import SOLID as SOLID
    from .correspondences import (
        epipolar_distances as epipolar_distances,
        flow_cycle_error as flow_cycle_error,
        flow_in_size as flow_in_size,
    )
    from .light_shares import gathered as gathered, same_model as same_model
    from .normals import (
        axis_normals as axis_normals,
        blended as blended,
        blended_normals as blended_normals,
        depth_normals as depth_normals,
    )
    from .overlap import sources_by_overlap as sources_by_overlap, view_overlap as view_overlap
    from .triangulation import triangulated_points as triangulated_points
    from .view_parameters import ViewParameters as ViewParameters
    from .viewing_angles import subject_of as subject_of, view_angles as view_angles
else:
    __all__, __dir__, __getattr__ = names_on_first_use(__name__)
