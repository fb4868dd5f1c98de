"""`depth_error` and `depth_within`: how far rendered depth is from the truth, where truth exists.

Two measures of the depth-estimation literature: the mean of |d - t| / t, and the share of pixels whose
|d - t| / t stays within a tolerance. Truth is a data set's own depth, or its sparse points.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from pydantic import Field

from registry import Register, Scene, Settings, Unavailable, View, ViewMetric, hookimpl

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Camera, Rendering

OPAQUE = 0.5
"""A pixel that lets more light through than this has no rendered depth."""


class DepthErrorSettings(Settings):
    against: Literal["depth", "points"] = "depth"
    """"depth": the view's own true depth; "points": the scene's sparse points that fall into the
    view, those that something hides there too."""


class DepthWithinSettings(DepthErrorSettings):
    percent: float = Field(1.0, gt=0, lt=100)
    """A depth counts as right within so many per cent of the truth; 1, 3 and 10 are usual."""


class DepthError(ViewMetric[DepthErrorSettings]):
    """Mean absolute relative error |d - t| / t of rendered depth; a hole counts as depth 0, so as 1."""

    higher_is_better = False

    def measure_view(self, rendering: Rendering, view: View, scene: Scene) -> float | Unavailable:
        """Return the mean over the pixels, or points, with a known truth inside the view's mask."""
        errors = relative_errors(rendering, view, scene, self.settings.against)
        return errors if isinstance(errors, Unavailable) else float(errors.mean())


class DepthWithin(ViewMetric[DepthWithinSettings]):
    """Share, 0 to 1, of rendered depths within `percent` of the truth; a hole is never within."""

    def measure_view(self, rendering: Rendering, view: View, scene: Scene) -> float | Unavailable:
        """Return the share of the pixels, or points, with a known truth inside the view's mask."""
        errors = relative_errors(rendering, view, scene, self.settings.against)
        if isinstance(errors, Unavailable):
            return errors
        return float((errors <= self.settings.percent / 100).double().mean())


def relative_errors(
    rendering: Rendering, view: View, scene: Scene, against: Literal["depth", "points"]
) -> Tensor | Unavailable:
    """|d - t| / t wherever the truth t is known, `[K]` float64, K > 0; a hole has d = 0."""
    opaque = rendering.alpha > OPAQUE
    depth = (rendering.depth.double() / rendering.alpha.double()).where(opaque, 0.0)
    if against == "depth":
        if view.depth is None:
            return Unavailable("the scene has no true depth for its views")
        counted = view.depth > 0
        if view.mask is not None:
            counted &= view.mask
        rendered, truth = depth[counted], view.depth[counted].double()
    else:
        if scene.points is None:
            return Unavailable("the scene has no points")
        rows, columns, truth = _project(scene.points.positions, view.camera)
        if view.mask is not None:
            inside = view.mask[rows, columns]
            rows, columns, truth = rows[inside], columns[inside], truth[inside]
        rendered = depth[rows, columns]
    if not len(truth):
        return Unavailable("no true depth falls into the view")
    return (rendered - truth).abs() / truth


def _project(positions: Tensor, camera: Camera) -> tuple[Tensor, Tensor, Tensor]:
    """Row, column and depth of the points in front of the camera that fall into its image."""
    u, v, depth = camera.project(positions)
    seen = camera.contains(u, v, depth)
    return v[seen].long(), u[seen].long(), depth[seen]


@hookimpl
def stereogs_register_metrics(register: Register[DepthError | DepthWithin]) -> None:
    register("depth_error", DepthError)
    register("depth_within", DepthWithin)
