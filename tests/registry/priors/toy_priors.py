"""A minimal prior of each capability."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar

import torch
from torch import Tensor

from core_rasterizer import open_device
from registry import Context, Prior, Settings, TrainingView
from registry.priors import (
    DepthMap,
    Matches,
    MatchingPrior,
    MonocularDepthPrior,
    MultiViewDepthPrior,
    OpticalFlowPrior,
    StereoPrior,
)


class ShiftSettings(Settings):
    limit: int = 8
    """Largest shift to try, pixels."""


class BestShift(StereoPrior[ShiftSettings]):
    """The single shift that fits the whole image best, at every pixel."""

    def estimate(self, left: Tensor, right: Tensor) -> Tensor:
        width = left.shape[1]
        errors = [
            (left[:, shift:] - right[:, : width - shift]).abs().mean()
            for shift in range(self.settings.limit)
        ]
        best = int(torch.stack(errors).argmin())
        answer = torch.full(left.shape[:2], float(best))
        answer[:, :best] = torch.nan  # outside the right image
        return answer


class Middle(MultiViewDepthPrior[Settings]):
    """The center of the bounds at all pixels except the first."""

    calls = 0

    def estimate(
        self, views: Sequence[TrainingView], bounds: tuple[float, float]
    ) -> list[DepthMap]:
        self.calls += 1
        maps = []
        for view in views:
            depth = torch.full(view.image.shape[:2], sum(bounds) / 2)
            depth[0, 0] = torch.inf
            maps.append(DepthMap(depth, depth > 0, torch.full_like(depth, 2.0)))
        return maps


class Brightness(MonocularDepthPrior[Settings]):
    """Brightness as inverse depth."""

    calls = 0

    def estimate(self, image: Tensor) -> Tensor:
        self.calls += 1
        return image.mean(dim=2)


PriorType = TypeVar("PriorType", bound=Prior[Any])


def built(component: type[PriorType], name: str = "prior") -> PriorType:
    return component(component.Settings(), Context(name, 0, open_device()))


def textured(width: int = 40) -> Tensor:
    return torch.rand(24, width, 3, generator=torch.Generator().manual_seed(3))


class Sideways(OpticalFlowPrior[Settings]):
    """Three pixels to the right; unknown at the first pixel."""

    calls = 0

    def estimate(self, first: Tensor, second: Tensor) -> Tensor:
        self.calls += 1
        flow = torch.zeros(*first.shape[:2], 2)
        flow[..., 0] = 3
        flow[0, 0] = torch.nan
        return flow


class Corners(MatchingPrior[Settings]):
    """Corners of the images; one match is outside, one score is too high."""

    calls = 0

    def estimate(self, first: Tensor, second: Tensor) -> Matches:
        self.calls += 1
        points = torch.tensor([[0.0, 0.0], [1.0, 1.0], [1e4, 1.0]])
        return Matches(points, points, torch.tensor([0.5, 7.0, 0.5]))
