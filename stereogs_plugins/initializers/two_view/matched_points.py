"""`matched_points`: a point for every match between two photographs that fits their cameras.

The initial points of Binocular3DGS (Han et al. 2024), who ask a dense matching network; from the training
photographs alone.
"""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING, Any

from pydantic import Field

from registry import Initializer, PointCloud, Prior, SceneError, Settings, TrainingScene
from registry.priors import MatchingPrior

if TYPE_CHECKING:
    from collections.abc import Mapping

    from torch import Tensor

    from registry import TrainingView


class MatchedPointsSettings(Settings):
    prior: str | None = None
    """Name of the matching prior; null takes the only one."""
    max_distance: float = Field(2.0, gt=0)
    """Pixels by which a match may miss its epipolar line."""
    min_score: float = Field(0.0, ge=0, le=1)
    """Matches that are less sure are left out."""


class MatchedPoints(Initializer[MatchedPointsSettings]):
    """Points where the first photograph's ray meets the match, moved onto its epipolar line."""

    ablation_baseline = "sfm"
    needs_priors = ("matches",)

    def initialize(self, scene: TrainingScene, priors: Mapping[str, Prior[Any]]) -> PointCloud:
        """Return at least one point.

        Raises:
            PluginError: the pipeline has no matching prior, or several and `prior` is null.
            SceneError: no match between two training views fits their cameras.
        """
        import torch

        prior = MatchingPrior.choose(priors, self.settings.prior)
        found = [self._pair(*pair, scene, prior) for pair in combinations(scene.train, 2)]
        counts = [len(positions) for positions, _ in found]
        if not any(counts):
            raise SceneError(
                f"no match between the {len(scene.train)} training views fits their cameras",
                where=scene.name,
                fix="use training views that overlap, check the poses, raise `max_distance`, or use the "
                "initializer `random`",
            )
        return PointCloud(
            positions=torch.cat([positions for positions, _ in found]).float(),
            colors=torch.cat([colors for _, colors in found]),
            facts={"points_by_pair": counts},
        )

    def _pair(
        self,
        first: TrainingView,
        second: TrainingView,
        scene: TrainingScene,
        prior: MatchingPrior[Any],
    ) -> tuple[Tensor, Tensor]:
        """Positions `[P, 3]` and colours `[P, 3]` from one pair."""
        from .epipolar import intersect, within_bounds

        matches = prior.matches_between(first, second)
        found = intersect(first.camera, second.camera, matches.first, matches.second)
        kept = (found.distance < self.settings.max_distance) & within_bounds(found.depth, scene)
        kept &= matches.scores >= self.settings.min_score
        u, v = matches.first[kept].unbind(dim=1)
        height, width = first.image.shape[:2]
        colors = first.image[v.long().clamp(max=height - 1), u.long().clamp(max=width - 1)]
        return first.camera.unproject(u, v, found.depth[kept]), colors
