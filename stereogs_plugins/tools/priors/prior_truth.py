"""How far a prior's answers are from the truth, on a scene whose depths are known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from registry import PluginError
from registry.priors import (
    MatchingPrior,
    MonocularDepthPrior,
    MultiViewDepthPrior,
    OpticalFlowPrior,
    StereoPrior,
)

if TYPE_CHECKING:
    from registry import Prior, TrainingView

PIXELS = 2.0
"""A disparity, a vector or a match that is off by more is wrong."""
RELATIVE_DEPTH = 0.03
"""A depth that is off by more is wrong."""
_SAME_SURFACE = 0.02
"""Relative difference of depth between two views of one point of one surface."""


@dataclass(frozen=True)
class Score:
    """How well a prior answered.

    Args:
        error: 0 for the truth, 1 for nothing right; for an order of depth 1 is none, 2 the reverse.
        text: the same for people, in its own unit.
    """

    error: float
    text: str


@dataclass(frozen=True, eq=False)
class Truth:
    """What is known of two rectified views and, behind them, of others.

    Args:
        views: all; the first two side by side, the second to the right of the first, with depth.
        bounds: (near, far) z-depth, world units.
        moved: `[H, W, 2]` pixels from a pixel of the first view to the same point in the second.
        visible: `[H, W]` bool, where the second view shows that point.
    """

    views: tuple[TrainingView, ...]
    bounds: tuple[float, float]
    moved: Tensor
    visible: Tensor


def truth_of(views: tuple[TrainingView, ...], bounds: tuple[float, float]) -> Truth:
    """What the depths of the first two views say. Both must have some."""
    first, second = views[:2]
    depth, other = (_depth(view) for view in (first, second))
    u, v = first.camera.pixel_centers()
    points = first.camera.unproject(u.ravel(), v.ravel(), depth.ravel())
    there_u, there_v, there_z = (x.reshape(depth.shape) for x in second.camera.project(points))
    height, width = other.shape
    inside = second.camera.contains(there_u, there_v)
    column, row = there_u.clamp(0, width - 1).long(), there_v.clamp(0, height - 1).long()
    same = (other[row, column] - there_z).abs() <= _SAME_SURFACE * there_z
    moved = torch.stack([there_u - u, there_v - v], dim=2)
    return Truth(views, bounds, moved, inside & same)


def judge(prior: Prior[Any], truth: Truth) -> Score:
    """Ask a prior and hold its answer against the truth; nothing is taken from the cache.

    Raises:
        PluginError: what the prior says, or a capability without a known question.
    """
    first, second = truth.views[:2]
    if isinstance(prior, StereoPrior):
        disparity = prior.disparity(first.image, second.image)
        errors = (disparity.values + truth.moved[..., 0]).abs()
        return _pixels(errors.where(disparity.valid, torch.inf)[truth.visible])
    if isinstance(prior, OpticalFlowPrior):
        flow = prior.flow(first.image, second.image)
        errors = (flow.vectors - truth.moved).norm(dim=2)
        return _pixels(errors.where(flow.valid, torch.inf)[truth.visible])
    if isinstance(prior, MultiViewDepthPrior):
        return _depths(prior, truth)
    if isinstance(prior, MonocularDepthPrior):
        return _order(prior.inverse_depth(first.image), 1 / _depth(first))
    if isinstance(prior, MatchingPrior):
        return _matches(prior, truth)
    raise PluginError(f"nothing is known to ask a prior of the capability {prior.capability!r}")


def _depth(view: TrainingView) -> Tensor:
    if view.depth is None:
        raise PluginError(f"the view {view.name!r} has no depth to compare with")
    return view.depth.double()


def _pixels(errors: Tensor) -> Score:
    """Of the pixels that both views show; infinite where there is no answer."""
    known = errors[torch.isfinite(errors)]
    wrong = float((errors > PIXELS).double().mean())
    middle = f"{float(known.median()):.2f} px" if len(known) else "none"
    return Score(
        wrong,
        f"{wrong:.1%} of the pixels that both images show are off by more than {PIXELS:g} px or "
        f"unknown; {len(known) / len(errors):.0%} have an answer, median error {middle}",
    )


def _depths(prior: MultiViewDepthPrior[Any], truth: Truth) -> Score:
    answer = prior.estimate(truth.views, truth.bounds)[0]
    expected = _depth(truth.views[0])
    errors = (answer.depth - expected).abs() / expected
    right = answer.valid & (errors <= RELATIVE_DEPTH)
    share = float(right.double().mean())
    known = float(answer.valid.double().mean())
    of_known = share / known if known else 0.0
    return Score(
        1 - share,
        f"depth right within {RELATIVE_DEPTH:.0%} in {share:.1%} of the pixels, and in {of_known:.1%} "
        f"of the {known:.0%} that have one",
    )


def _order(answer: Tensor, expected: Tensor) -> Score:
    """By Spearman's rank correlation, which knows no scale and no shift."""
    from scipy.stats import spearmanr

    if answer.min() == answer.max():
        return Score(1.0, "the same answer for every pixel")
    correlation = float(spearmanr(answer.ravel().numpy(), expected.ravel().numpy()).statistic)
    return Score(1 - correlation, f"rank correlation {correlation:.2f} with the true inverse depth")


def _matches(prior: MatchingPrior[Any], truth: Truth) -> Score:
    found = prior.matches(*(view.image for view in truth.views[:2]))
    height, width = truth.visible.shape
    column = found.first[:, 0].clamp(0, width - 1).long()
    row = found.first[:, 1].clamp(0, height - 1).long()
    errors = (found.second - found.first - truth.moved[row, column]).norm(dim=1)
    if not len(errors):
        return Score(1.0, "no matches")
    wrong = float((errors > PIXELS).double().mean())
    return Score(
        wrong,
        f"{len(errors)} matches, {wrong:.1%} of them off by more than {PIXELS:g} px, "
        f"median error {float(errors.median()):.2f} px",
    )
