"""How far to the right the virtual camera of a stereo pair stands."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import median
from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from registry import PluginError, Settings, Step, TrainingView

SHARE_OF_WIDTH = 0.20
"""Of the image width: the disparity of near content under the adaptive rule."""
LARGEST_SHARE = 0.35
"""Of the image width: beyond this disparity too little of the two images overlaps."""
MATCHER_MARGIN = 0.9
"""Near content stays below this share of what the matcher can answer."""
SMALLEST_MEDIAN = 4.0
"""Pixels: below this, errors of a fraction of a pixel are large errors in depth."""
_NEAR, _MIDDLE = 0.05, 0.5
_SOLID = 0.5
"""Alpha from which a rendered depth counts."""


class BaselineSettings(Settings):
    """The distance between the two cameras of a pair."""

    mode: Literal["adaptive", "world", "extent"] = "adaptive"
    """adaptive: so that near content has the disparity value * image width; world: value in world units;
    extent: value * the scene's extent."""
    value: float | None = Field(default=None, gt=0, allow_inf_nan=False)
    """What `mode` says; null is 0.2 for adaptive, the others need a number. StereoGS: world, 4.0."""

    @model_validator(mode="after")
    def _has_a_value(self) -> Self:
        if self.value is None and self.mode != "adaptive":
            raise ValueError(f"mode {self.mode} needs a value")
        return self


@dataclass(frozen=True)
class DepthRange:
    """Of one training view: near (5th percentile) and middle (median) z-depth, world units."""

    view: TrainingView
    near: float
    middle: float

    def disparity(self, depth: float, baseline: float) -> float:
        """In pixels, of content at `depth`."""
        return self.view.camera.fx * baseline / depth


def choose_baseline(settings: BaselineSettings, step: Step, max_disparity: float | None) -> float:
    """The baseline in world units for the scene as the Gaussians show it now.

    Adaptive: d = value * W * z_near / f_x in every training view, where z_near is the 5th percentile
    of its depth; lengthened until the median depth has 4 px of disparity, and then shortened until
    near content stays within 0.35 W and 0.9 of the matcher's reach. The scene takes the views' median.

    Args:
        max_disparity: the matcher's reach in pixels, or None.

    Raises:
        PluginError: a baseline of the user's for which nothing could be matched in some view.
    """
    ranges = [_depth_range(step, view) for view in step.scene.train]
    if settings.mode == "adaptive":
        share = SHARE_OF_WIDTH if settings.value is None else settings.value
        return median(_adaptive(r, share, max_disparity) for r in ranges)
    assert settings.value is not None
    unit = 1.0 if settings.mode == "world" else step.extent
    baseline = settings.value * unit
    for r in ranges:
        _check_overlap(r, baseline, max_disparity, unit)
    return baseline


def _adaptive(r: DepthRange, share: float, max_disparity: float | None) -> float:
    width, per_pixel = r.view.camera.width, 1 / r.view.camera.fx
    reach = LARGEST_SHARE * width
    if max_disparity is not None:
        reach = min(reach, MATCHER_MARGIN * max_disparity)
    wanted = max(share * width * r.near * per_pixel, SMALLEST_MEDIAN * r.middle * per_pixel)
    return min(wanted, reach * r.near * per_pixel)


def _check_overlap(
    r: DepthRange, baseline: float, max_disparity: float | None, unit: float
) -> None:
    near, middle = r.disparity(r.near, baseline), r.disparity(r.middle, baseline)
    width = r.view.camera.width
    if near > width:
        problem = f"near content has a disparity of {near:.0f} px in an image {width} px wide"
        largest = baseline * LARGEST_SHARE * width / near
    elif max_disparity is not None and middle > max_disparity:
        problem = (
            f"the median depth has a disparity of {middle:.0f} px, and the prior "
            f"answers up to {max_disparity:g} px"
        )
        largest = baseline * MATCHER_MARGIN * max_disparity / middle
    else:
        return
    raise PluginError(
        f"the baseline of {baseline:g} world units is too long: {problem}",
        where=f"view {r.view.name!r}",
        fix=f"set baseline.mode to adaptive, or baseline.value to {largest / unit:.3g} or less",
    )


def _depth_range(step: Step, view: TrainingView) -> DepthRange:
    """From a render of the view; from the scene's bounds if it shows nothing solid."""
    rendering = step.render(view.camera, gradient=False)
    solid = rendering.alpha > _SOLID
    if not solid.any():
        near, far = step.scene.bounds
        return DepthRange(view, near, 2 / (1 / near + 1 / far))
    depth = (rendering.depth[solid] / rendering.alpha[solid]).numpy()
    near, middle = np.quantile(depth, (_NEAR, _MIDDLE))
    return DepthRange(view, float(near), float(middle))
