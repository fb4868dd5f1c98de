"""`depth_error` and `depth_within`: errors of rendered depth against ground truth.

Two measures of the depth-estimation literature: the mean of |d - t| / t, and the share of pixels whose
|d - t| / t is within a tolerance. The ground truth is the data set's depth, or its sparse points.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from pydantic import Field

from registry import Register, Scene, Settings, Unavailable, View, ViewMetric, hookimpl

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Camera, Rendering

OPAQUE = 0.5
"""Minimum alpha of a pixel with a rendered depth."""


class DepthErrorSettings(Settings):
    against: Literal["depth", "points"] = "depth"
    """"depth": the view's true depth; "points": the scene's sparse points that project into the view,
    including occluded ones."""


class DepthWithinSettings(DepthErrorSettings):
    percent: float = Field(1.0, gt=0, lt=100)
    """Tolerance in per cent of the true depth; common values are 1, 3 and 10."""


class DepthError(ViewMetric[DepthErrorSettings]):
    """Mean absolute relative error |d - t| / t of rendered depth; holes have depth 0, so error 1."""

    higher_is_better = False

    def measure_view(self, rendering: Rendering, view: View, scene: Scene) -> float | Unavailable:
        """Return the mean over the pixels, or points, with a known truth inside the view's mask."""
        errors = relative_errors(rendering, view, scene, self.settings.against)
        return errors if isinstance(errors, Unavailable) else float(errors.mean())


class DepthWithin(ViewMetric[DepthWithinSettings]):
    """Share, 0 to 1, of rendered depths within `percent` of the true depth; holes are outside."""

    def measure_view(self, rendering: Rendering, view: View, scene: Scene) -> float | Unavailable:
        """Return the share of the pixels, or points, with a known truth inside the view's mask."""
        errors = relative_errors(rendering, view, scene, self.settings.against)
        if isinstance(errors, Unavailable):
            return errors
        return float((errors <= self.settings.percent / 100).double().mean())


def relative_errors(
    rendering: Rendering, view: View, scene: Scene, against: Literal["depth", "points"]
) -> Tensor | Unavailable:
    """Return |d - t| / t where the true depth t is known, `[K]` float64, K > 0; holes have d = 0."""
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
        return Unavailable("the view has no pixel with true depth")
    return (rendered - truth).abs() / truth


def _project(positions: Tensor, camera: Camera) -> tuple[Tensor, Tensor, Tensor]:
    """Return row, column and depth of the points that project into the camera's image."""
    u, v, depth = camera.project(positions)
    seen = camera.contains(u, v, depth)
    return v[seen].long(), u[seen].long(), depth[seen]


@hookimpl
def stereogs_register_metrics(register: Register[DepthError | DepthWithin]) -> None:
    register("depth_error", DepthError)
    register("depth_within", DepthWithin)
