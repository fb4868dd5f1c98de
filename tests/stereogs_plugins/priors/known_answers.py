"""Priors with fixed results."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor

from registry import PointCloud, Settings, TrainingView
from registry.priors import (
    DepthMap,
    GaussiansPrior,
    Matches,
    MatchingPrior,
    MonocularDepthPrior,
    MultiViewDepthPrior,
    OpticalFlowPrior,
    StereoPrior,
)
from tests.stereogs_plugins.building import build


def stereo(answer: Tensor) -> StereoPrior[Settings]:
    """Returns a fixed disparity `[H, W]`."""

    class Known(StereoPrior[Settings]):
        def estimate(self, left: Tensor, right: Tensor) -> Tensor:
            return answer

    return build(Known)


def flow(answer: Tensor) -> OpticalFlowPrior[Settings]:
    """Returns a fixed flow `[H, W, 2]`."""

    class Known(OpticalFlowPrior[Settings]):
        def estimate(self, first: Tensor, second: Tensor) -> Tensor:
            return answer

    return build(Known)


def depth(answer: DepthMap) -> MultiViewDepthPrior[Settings]:
    """Returns one fixed depth map for every view."""

    class Known(MultiViewDepthPrior[Settings]):
        def estimate(
            self, views: Sequence[TrainingView], bounds: tuple[float, float]
        ) -> list[DepthMap]:
            return [answer for _ in views]

    return build(Known)


def nearness(answer: Tensor) -> MonocularDepthPrior[Settings]:
    """Returns a fixed relative inverse depth `[H, W]`."""

    class Known(MonocularDepthPrior[Settings]):
        def estimate(self, image: Tensor) -> Tensor:
            return answer

    return build(Known)


def matches(answer: Matches) -> MatchingPrior[Settings]:
    """Returns fixed matches."""

    class Known(MatchingPrior[Settings]):
        def estimate(self, first: Tensor, second: Tensor) -> Matches:
            return answer

    return build(Known)


def gaussians(answer: PointCloud) -> GaussiansPrior[Settings]:
    """Returns fixed Gaussians."""

    class Known(GaussiansPrior[Settings]):
        def estimate(
            self, views: Sequence[TrainingView], bounds: tuple[float, float]
        ) -> PointCloud:
            return answer

    return build(Known)
