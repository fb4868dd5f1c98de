"""Capabilities of priors: checks of inputs and estimates, choice of a prior."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from registry import PluginError, Settings, TrainingView
from registry.priors import (
    DepthMap,
    Matches,
    MatchingPrior,
    MonocularDepthPrior,
    MultiViewDepthPrior,
    NormalPrior,
    OpticalFlowPrior,
    StereoPrior,
)
from registry.testing import check, tiny_scene
from tests.registry.priors.toy_priors import (
    BestShift,
    Brightness,
    Corners,
    Middle,
    Sideways,
    built,
    textured,
)


@pytest.mark.parametrize("component", [BestShift, Middle, Brightness])
def test_toy_priors_keep_the_contract(component: type) -> None:
    check(component)


def test_disparity_of_a_shifted_pair_and_of_its_mirror_image() -> None:
    texture = textured()
    left, right = texture[:, :32], texture[:, 5:37]  # left(u) = right(u - 5)
    of_left, of_right = built(BestShift).both(left, right)
    assert of_left.valid[:, 5:].all()
    assert not of_left.valid[:, :5].any()
    assert (of_left.values[:, 5:] == 5).all()
    assert (of_left.values[:, :5] == 0).all()
    # The right image is the left image shifted by five pixels.
    assert (of_right.values[:, :-5] == 5).all()
    assert not of_right.valid[:, -5:].any()


def test_images_of_a_pair_must_have_equal_sizes() -> None:
    with pytest.raises(PluginError, match="both must be"):
        built(BestShift).disparity(textured(32), textured(33))


@pytest.mark.parametrize("answer", [torch.tensor(1.0), torch.ones(24), 1.0, None])
def test_an_estimate_of_another_shape_is_refused(
    answer: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(BestShift, "estimate", lambda self, left, right: answer)
    for ask in (built(BestShift).disparity, built(BestShift).both):
        with pytest.raises(PluginError, match=r"expected a tensor of shape \(24, 40\)"):
            ask(textured(), textured())


def test_depths_that_are_not_finite_are_not_valid() -> None:
    scene = tiny_scene()
    maps = built(Middle).depths(scene.train, scene.bounds)
    assert len(maps) == len(scene.train)
    for answer in maps:
        assert not answer.valid[0, 0]
        assert answer.depth[0, 0] == 0
        assert answer.confidence[0, 0] == 0
        assert answer.valid.sum() == answer.valid.numel() - 1
        assert answer.confidence.max() == 1


def test_one_view_is_too_few() -> None:
    scene = tiny_scene()
    with pytest.raises(PluginError, match="needs two views"):
        built(Middle).depths(scene.train[:1], scene.bounds)


class TooMany(Middle):
    def estimate(
        self, views: Sequence[TrainingView], bounds: tuple[float, float]
    ) -> list[DepthMap]:
        return super().estimate(views, bounds)[:1]


class WrongShape(MonocularDepthPrior[Settings]):
    def estimate(self, image: Tensor) -> Tensor:
        return image.mean(dim=2)[1:]


def test_estimates_of_a_wrong_length_or_shape_are_refused() -> None:
    scene = tiny_scene()
    with pytest.raises(PluginError, match="1 depth maps came for 2 views"):
        built(TooMany).depths(scene.train, scene.bounds)
    with pytest.raises(PluginError, match=r"expected a tensor of shape \(24, 32\)"):
        built(WrongShape).inverse_depth(scene.train[0].image)


def test_a_prior_is_chosen_by_name_or_as_the_only_one() -> None:
    first, second, mono = built(Middle), built(Middle), built(Brightness)
    assert MultiViewDepthPrior.choose({"a": first, "m": mono}, None) is first
    assert MultiViewDepthPrior.choose({"a": first, "b": second}, "b") is second
    with pytest.raises(PluginError, match="2 priors have the capability") as many:
        MultiViewDepthPrior.choose({"a": first, "b": second}, None)
    assert "a, b" in many.value.fix
    with pytest.raises(PluginError, match="the pipeline has none"):
        StereoPrior.choose({"m": mono}, None)
    with pytest.raises(PluginError, match="'m' has the capability 'monocular_depth'"):
        StereoPrior.choose({"m": mono}, "m")
    with pytest.raises(PluginError, match="no prior named 'x'"):
        StereoPrior.choose({}, "x")


def test_a_stereo_prior_without_known_values_is_reported_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    class Nowhere(StereoPrior[Settings]):
        def estimate(self, left: Tensor, right: Tensor) -> Tensor:
            return torch.full(left.shape[:2], float("nan"))

    prior, image = built(Nowhere, "blind"), textured()
    for _ in range(2):
        assert not prior.disparity(image, image).valid.any()
    assert caplog.messages == ["prior 'blind' returned no known disparity"]


class Torch(MonocularDepthPrior[Settings]):
    """Brightness, with autograd."""

    differentiable = True

    def estimate(self, image: Tensor) -> Tensor:
        return image.mean(dim=2)


def test_a_differentiable_prior_propagates_gradients() -> None:
    image = torch.rand(4, 5, 3, requires_grad=True)
    built(Torch).inverse_depth(image).sum().backward()
    assert image.grad is not None
    torch.testing.assert_close(image.grad, torch.full((4, 5, 3), 1 / 3))
    assert not built(Brightness).inverse_depth(image).requires_grad


def test_a_flow_is_checked_and_cached_between_views(cache: Path) -> None:
    check(Sideways)
    (first, second), prior = tiny_scene().train, built(Sideways)
    flow = prior.flow_between(first, second)
    assert torch.equal(prior.flow_between(first, second).vectors, flow.vectors)
    assert prior.calls == 1
    assert not flow.valid[0, 0]
    assert int(flow.valid.sum()) == flow.valid.numel() - 1
    assert flow.vectors[0, 0].tolist() == [0, 0]
    assert flow.vectors[3, 4].tolist() == [3, 0]
    prior.flow(first.image, second.image)
    assert prior.calls == 2


def test_matches_are_checked_and_cached_between_views(cache: Path) -> None:
    check(Corners)
    (first, second), prior = tiny_scene().train, built(Corners)
    matches = prior.matches_between(first, second)
    assert prior.matches_between(first, second).first.tolist() == [[0, 0], [1, 1]]
    assert matches.scores.tolist() == [0.5, 1]
    assert prior.calls == 1


def test_matches_outside_their_own_image_are_dropped() -> None:
    class Right(MatchingPrior[Settings]):
        def estimate(self, first: Tensor, second: Tensor) -> Matches:
            points = torch.tensor([[1.0, 1.0], [7.0, 1.0]])
            return Matches(points, points, torch.ones(2))

    small, large = torch.zeros(4, 5, 3), torch.zeros(4, 9, 3)
    for images in ((small, large), (large, small)):
        assert built(Right).matches(*images).first.tolist() == [[1, 1]]


class Crooked(MatchingPrior[Settings]):
    def estimate(self, first: Tensor, second: Tensor) -> Matches:
        return Matches(torch.zeros(3, 2), torch.zeros(2, 2), torch.zeros(3))


class Narrow(OpticalFlowPrior[Settings]):
    def estimate(self, first: Tensor, second: Tensor) -> Tensor:
        return first


def test_estimates_of_a_wrong_shape_are_refused() -> None:
    image = torch.rand(4, 5, 3)
    with pytest.raises(
        PluginError, match="second is \\(2, 2\\), expected a tensor of shape \\(3, 2\\)"
    ):
        built(Crooked).matches(image, image)
    with pytest.raises(PluginError, match="expected a tensor of shape \\(4, 5, 2\\)"):
        built(Narrow).flow(image, image)


class Slanted(NormalPrior[Settings]):
    """Normals of length 5; unknown in the first two pixels."""

    calls = 0

    def estimate(self, image: Tensor) -> Tensor:
        self.calls += 1
        normals = torch.tensor([0.0, 3, -4]).expand(image.shape).clone()
        normals[0, 0] = 0
        normals[0, 1:2, 0] = torch.nan
        return normals


def test_normals_have_length_one_where_they_are_known_and_are_cached(cache: Path) -> None:
    view, prior = tiny_scene().train[0], built(Slanted)
    for _ in range(2):
        normals = prior.normals_of(view)
    assert prior.calls == 1
    assert normals[0, :2].tolist() == [[0, 0, 0], [0, 0, 0]]
    torch.testing.assert_close(normals[1, 0], torch.tensor([0, 0.6, -0.8]))


def test_normals_of_a_wrong_shape_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Slanted, "estimate", lambda self, image: image[..., :2])
    with pytest.raises(PluginError, match="expected a tensor of shape \\(24, 32, 3\\)"):
        built(Slanted).normals(tiny_scene().train[0].image)
