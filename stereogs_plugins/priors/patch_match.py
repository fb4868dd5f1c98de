"""`patch_match`: depth of posed views by slanted-plane PatchMatch; needs no model file.

Each pixel has its own plane, found by trying the planes of other pixels and random changes. Slanted surfaces
and wide baselines therefore match as well as frontal ones. A consistency term draws views towards each other.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from pydantic import Field

from core_rasterizer.matching import MAX_PATCH_SOURCES
from registry import PluginError, Register, Settings, TrainingView, hookimpl
from registry.priors import DepthMap, MultiViewDepthPrior
from registry.toolkit.images import grey
from registry.toolkit.progress import progress

if TYPE_CHECKING:
    from collections.abc import Sequence


_NO_MATCH = 0.9
"""Cost from which on windows count as uncorrelated."""

NEAR_MARGIN, FAR_MARGIN = 0.9, 1.2
"""Least and largest depth as multiples of the scene's near and far bound."""


class PatchMatchSettings(Settings):
    removed: ClassVar = {"near_margin": NEAR_MARGIN, "far_margin": FAR_MARGIN}
    max_sources: int = Field(5, ge=1, le=MAX_PATCH_SOURCES)
    """Largest number of source views per view, chosen by overlap and triangulation angle."""
    radius: int = Field(3, ge=1, le=12)
    """Radius of the compared windows in pixels; every second pixel is used."""


class PatchMatchPrior(MultiViewDepthPrior[PatchMatchSettings]):
    """Slanted-plane PatchMatch over several source views, coarse to fine."""

    def fingerprint(self) -> str:
        """The device; another one may round differently."""
        device = self.context.device
        return f"{device.platform} {device.name} {device.driver} {device.variant}"

    def estimate(
        self, views: Sequence[TrainingView], bounds: tuple[float, float]
    ) -> list[DepthMap]:
        """Return one depth map for each view.

        A depth is valid where its windows correlate and the point projects into a source view. The
        confidence is 1 minus the cost of mismatch and of disagreement between views. Random planes do not
        depend on the pipeline's seed.

        Raises:
            PluginError: all cameras are at the same position.
        """
        from core_rasterizer.matching import PatchMatch, seen_by_any, source_views

        settings = self.settings
        reach = bounds[0] * NEAR_MARGIN, bounds[1] * FAR_MARGIN
        cameras = [view.camera for view in views]
        sources = source_views(cameras, settings.max_sources, reach)
        if not all(sources):
            raise PluginError(
                f"the {len(cameras)} cameras are at the same position, so depth cannot be estimated",
                fix="use views from different positions, or check the poses",
            )
        greys = [grey(view.image) for view in views]
        matcher = PatchMatch(self.context.device, greys, cameras, reach, radius=settings.radius)
        count, maps = len(views), []
        planes = matcher.maps(sources, lambda share: progress("depth", int(share * count), count))
        for found, camera, others in zip(planes, cameras, sources, strict=True):
            seen = seen_by_any(found.depth.double(), camera, [cameras[k] for k in others])
            valid = seen & (found.cost < _NO_MATCH)
            maps.append(DepthMap(found.depth, valid, (1 - found.cost).clamp(0, 1)))
        return maps


@hookimpl
def stereogs_register_priors(register: Register[PatchMatchPrior]) -> None:
    register("patch_match", PatchMatchPrior)
