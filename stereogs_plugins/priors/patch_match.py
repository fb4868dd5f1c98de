"""`patch_match`: depth of posed views by slanted planes that spread over the image; needs no model file.

Each pixel has a plane of its own, found by trying those of other pixels and random changes, so that
surfaces seen at an angle and from far apart match as well as those that face the camera. Views are drawn
towards agreeing with each other.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from core_rasterizer.matching import MOST_PATCH_SOURCES
from registry import PluginError, Register, Settings, TrainingView, hookimpl
from registry.priors import DepthMap, MultiViewDepthPrior
from registry.toolkit.drawing import grey

if TYPE_CHECKING:
    from collections.abc import Sequence


_NO_MATCH = 0.9
"""Cost from which on the windows are as good as uncorrelated: nothing was found there."""


class PatchMatchSettings(Settings):
    near_margin: float = Field(0.9, gt=0, le=1)
    """Nothing is nearer than so many times the scene's near bound."""
    far_margin: float = Field(1.2, ge=1, allow_inf_nan=False)
    """Nothing is farther than so many times the scene's far bound."""
    max_sources: int = Field(5, ge=1, le=MOST_PATCH_SOURCES)
    """Each view is compared with so many others at most: those that see the same under a good angle."""
    radius: int = Field(3, ge=1, le=12)
    """Radius of the windows that are compared, pixels; every second pixel counts."""


class PatchMatchPrior(MultiViewDepthPrior[PatchMatchSettings]):
    """Slanted-plane PatchMatch over several source views, coarse to fine."""

    def fingerprint(self) -> str:
        """The device, since another may round a sample differently."""
        device = self.context.device
        return f"{device.platform} {device.name} {device.driver} {device.variant}"

    def estimate(
        self, views: Sequence[TrainingView], bounds: tuple[float, float]
    ) -> list[DepthMap]:
        """Return one depth map for each view.

        A depth is valid where its window matches at all and the point projects into another view that it
        was compared with. The confidence is 1 less the cost: of windows that do not match, and of views
        that disagree. Random planes are the same for every run: the pipeline's seed changes nothing.

        Raises:
            PluginError: all cameras stand in one place.
        """
        from core_rasterizer.matching import PatchMatch, seen_by_any, source_views

        settings = self.settings
        reach = bounds[0] * settings.near_margin, bounds[1] * settings.far_margin
        cameras = [view.camera for view in views]
        sources = [
            source_views(cameras, index, settings.max_sources, reach) for index in range(len(views))
        ]
        if not all(sources):
            raise PluginError(
                f"the {len(cameras)} cameras stand in one place, from where no depth can be seen",
                fix="use views from different places, or check the poses",
            )
        greys = [grey(view.image) for view in views]
        matcher = PatchMatch(self.context.device, greys, cameras, reach, radius=settings.radius)
        maps = []
        for found, camera, others in zip(matcher.maps(sources), cameras, sources, strict=True):
            seen = seen_by_any(found.depth.double(), camera, [cameras[k] for k in others])
            valid = seen & (found.cost < _NO_MATCH)
            maps.append(DepthMap(found.depth, valid, (1 - found.cost).clamp(0, 1)))
        return maps


@hookimpl
def stereogs_register_priors(register: Register[PatchMatchPrior]) -> None:
    register("patch_match", PatchMatchPrior)
