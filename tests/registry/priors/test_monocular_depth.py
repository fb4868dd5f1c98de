"""Answers of monocular priors: what is checked, completed and cached."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from registry import PluginError, PointCloud, Settings, TrainingView
from registry.priors import MonocularDepth, MonocularDepthPrior
from registry.testing import check, tiny_scene
from tests.registry.priors.toy_priors import Brightness, built


class Complete(MonocularDepthPrior[Settings]):
    """Depth with all that networks know besides; the first row is sky. Aligned to points if there are any."""

    calls = 0

    def estimate(self, image: Tensor) -> MonocularDepth:
        depth = 1 + image.mean(dim=2)
        depth[0] = torch.inf
        normals = torch.zeros_like(image)
        normals[..., 2] = -3
        return MonocularDepth(
            depth,
            inverse=False,
            ambiguity="metric",
            valid=image[..., 0] >= 0,
            confidence=torch.full_like(depth, 0.5),
            intrinsics=torch.eye(3),
            normals=normals,
        )

    def estimate_view(self, view: TrainingView, points: PointCloud | None) -> MonocularDepth:
        self.calls += 1
        found = self.estimate(view.image)
        if points is None:
            return found
        farthest = float(view.camera.project(points.positions)[2].max())
        return replace(found, values=found.values * farthest, ambiguity="scale")


def test_priors_of_both_forms_keep_the_contract() -> None:
    check(Complete)
    check(Brightness)


def test_a_complete_answer_is_checked_and_returned_from_the_cache(cache: Path) -> None:
    view, prior = tiny_scene().train[0], built(Complete)
    for _ in range(2):
        found = prior.depth_of(view)
        assert (found.inverse, found.ambiguity) == (False, "metric")
        assert found.valid is not None
        assert found.valid.sum(dim=1).tolist() == [0, *[32] * 23]
        assert (found.values[0] == found.values[1:].max()).all()
        assert torch.equal(found.farness, found.values)
        torch.testing.assert_close(found.nearness, 1 / found.values)
        assert found.confidence is not None
        assert found.confidence.sum(dim=1).tolist() == [0, *[16] * 23]
        assert found.normals is not None
        assert found.normals[:2, 0].tolist() == [[0, 0, 0], [0, 0, -1]]
        assert found.intrinsics is not None
    assert prior.calls == 1


def test_a_prior_may_align_its_answer_to_the_points_of_the_scene(cache: Path) -> None:
    scene, prior = tiny_scene(), built(Complete)
    view, points = scene.train[0], scene.points
    assert points is not None
    farther = replace(points, positions=points.positions + torch.tensor([0.0, 0, 1]))
    alone, aligned, other = (prior.depth_of(view, given) for given in (None, points, farther))
    assert prior.calls == 3
    assert aligned.ambiguity == "scale"
    assert alone.values[1:].max() < aligned.values[1:].max() < other.values[1:].max()
    # A prior that does not read them answers once.
    plain = built(Brightness)
    for given in (None, points, farther):
        plain.depth_of(view, given)
    assert plain.calls == 1


def test_farness_and_nearness_are_what_the_ambiguity_allows() -> None:
    two = torch.full((1, 1), 2.0)
    assert MonocularDepth(two).farness == -2
    assert MonocularDepth(two).nearness == 2
    assert MonocularDepth(two, ambiguity="scale").farness == 0.5
    assert MonocularDepth(two, inverse=False).farness == 2
    with pytest.raises(PluginError, match="cannot be inverted"):
        _ = MonocularDepth(two, inverse=False).nearness


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"ambiguity": "none"}, "use one of affine, scale, metric"),
        ({"confidence": torch.full((24, 32), 1.5)}, "1.5 to 1.5, not 0 to 1"),
        ({"valid": torch.ones(24, 31)}, "expected a tensor of shape"),
        ({"normals": torch.ones(24, 32)}, "expected a tensor of shape"),
        (
            {"intrinsics": torch.full((3, 3), torch.nan)},
            "intrinsics has values that are not finite",
        ),
        ({"values": None}, "the depth is NoneType"),
    ],
)
def test_answers_that_break_the_contract_are_refused(
    change: dict[str, Any], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = Complete.estimate
    monkeypatch.setattr(
        Complete, "estimate", lambda self, image: replace(whole(self, image), **change)
    )
    with pytest.raises(PluginError, match=message):
        built(Complete).depth(tiny_scene().train[0].image)


def test_an_answer_without_valid_pixels_is_finite(monkeypatch: pytest.MonkeyPatch) -> None:
    nowhere = MonocularDepth(torch.zeros(24, 32), ambiguity="scale")
    monkeypatch.setattr(Complete, "estimate", lambda self, image: nowhere)
    found = built(Complete).depth(tiny_scene().train[0].image)
    assert found.valid is not None
    assert not found.valid.any()
    assert found.farness.isfinite().all()
