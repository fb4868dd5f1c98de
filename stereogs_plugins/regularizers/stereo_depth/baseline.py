"""Baseline of the virtual stereo pair."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import median
from typing import Literal, Self

from pydantic import Field, model_validator

from registry import PluginError, Settings, Step, TrainingView

SHARE_OF_WIDTH = 0.20
"""Disparity of near content under the adaptive rule, as a share of the image width."""
MAX_SHARE = 0.35
"""Largest disparity of near content, as a share of the image width, for sufficient overlap."""
MATCHER_MARGIN = 0.9
"""Largest disparity of near content, as a share of the matcher's largest disparity."""
MIN_MEDIAN = 4.0
"""Pixels: at smaller disparities, sub-pixel errors are large errors in depth."""
_NEAR, _MIDDLE = 0.05, 0.5
_SURFACE_ALPHA = 0.5
"""Minimum alpha of a valid rendered depth."""


class BaselineSettings(Settings):
    """The distance between the two cameras of a pair."""

    mode: Literal["adaptive", "world", "extent"] = "adaptive"
    """adaptive: near content has the disparity value * image width; world: value in the units of the
    scene's files; extent: value * the scene's extent."""
    value: float | None = Field(default=None, gt=0, allow_inf_nan=False)
    """Value for `mode`; null means 0.2 for adaptive, other modes require a value. StereoGS: world, 4.0."""

    @model_validator(mode="after")
    def _has_a_value(self) -> Self:
        if self.value is None and self.mode != "adaptive":
            raise ValueError(f"mode {self.mode} needs a value")
        return self


@dataclass(frozen=True)
class DepthRange:
    """Near (5th percentile) and middle (median) z-depth of a training view, world units."""

    view: TrainingView
    near: float
    middle: float

    def disparity(self, depth: float, baseline: float) -> float:
        """Return the disparity of content at `depth`, pixels."""
        return self.view.camera.fx * baseline / depth


def choose_baseline(settings: BaselineSettings, step: Step, max_disparity: float | None) -> float:
    """Return the baseline in the frame of training, from the current renders of the training views.

    Adaptive: d = value * W * z_near / f_x in every training view, where z_near is the 5th percentile
    of its depth; increased until the median depth has 4 px of disparity, then decreased until near
    content is within 0.35 W and 0.9 of the matcher's largest disparity. The result is the median over views.

    Args:
        max_disparity: the matcher's largest disparity in pixels, or None.

    Raises:
        PluginError: the user's baseline is too long for some view.
    """
    ranges = [_depth_range(step, view) for view in step.scene.train]
    if settings.mode == "adaptive":
        share = SHARE_OF_WIDTH if settings.value is None else settings.value
        return median(_adaptive(r, share, max_disparity) for r in ranges)
    assert settings.value is not None
    unit = 1 / step.scene.frame.unit if settings.mode == "world" else step.extent
    baseline = settings.value * unit
    for r in ranges:
        _check_overlap(r, baseline, max_disparity, unit)
    return baseline


def _adaptive(r: DepthRange, share: float, max_disparity: float | None) -> float:
    width, per_pixel = r.view.camera.width, 1 / r.view.camera.fx
    reach = MAX_SHARE * width
    if max_disparity is not None:
        reach = min(reach, MATCHER_MARGIN * max_disparity)
    wanted = max(share * width * r.near * per_pixel, MIN_MEDIAN * r.middle * per_pixel)
    return min(wanted, reach * r.near * per_pixel)


def _check_overlap(
    r: DepthRange, baseline: float, max_disparity: float | None, unit: float
) -> None:
    near, middle = r.disparity(r.near, baseline), r.disparity(r.middle, baseline)
    width = r.view.camera.width
    if near > width:
        problem = f"near content has a disparity of {near:.0f} px in an image {width} px wide"
        largest = baseline * MAX_SHARE * width / near
    elif max_disparity is not None and middle > max_disparity:
        problem = (
            f"the median depth has a disparity of {middle:.0f} px, and the prior "
            f"supports up to {max_disparity:g} px"
        )
        largest = baseline * MATCHER_MARGIN * max_disparity / middle
    else:
        return
    raise PluginError(
        f"the baseline, `value` {baseline / unit:g}, is too long: {problem}",
        where=f"view {r.view.name!r}",
        fix=f"set baseline.mode to adaptive, or baseline.value to {largest / unit:.3g} or less",
    )


def _depth_range(step: Step, view: TrainingView) -> DepthRange:
    """Return the range from a render of the view, or from the scene's bounds if no pixel is solid."""
    import numpy as np

    rendering = step.render(view.camera, gradient=False)
    solid = rendering.alpha > _SURFACE_ALPHA
    if not solid.any():
        near, far = step.scene.bounds
        return DepthRange(view, near, 2 / (1 / near + 1 / far))
    depth = (rendering.depth[solid] / rendering.alpha[solid]).numpy()
    near, middle = np.quantile(depth, (_NEAR, _MIDDLE))
    return DepthRange(view, float(near), float(middle))
