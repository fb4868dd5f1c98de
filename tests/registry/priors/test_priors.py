"""Prior models by capability: the question is checked, the answer is cleaned, the right one is found."""

from __future__ import annotations

import json
import logging
import resource
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import pytest
import torch
from safetensors.torch import load_file
from torch import Tensor

from core_rasterizer import open_device
from registry import (
    Context,
    DepthMap,
    Matches,
    MatchingPrior,
    MonocularDepthPrior,
    MultiViewDepthPrior,
    OpticalFlowPrior,
    PluginError,
    Prior,
    Settings,
    StereoPrior,
    View,
)
from registry.plugins.discovery import GROUP
from registry.priors.prior_cache import PriorCache, code_digest, source_digest
from registry.testing import check, tiny_scene


class ShiftSettings(Settings):
    limit: int = 8
    """Largest shift tried, in pixels."""


class BestShift(StereoPrior[ShiftSettings]):
    """The one shift that explains the whole image best, at every pixel."""

    def estimate(self, left: Tensor, right: Tensor) -> Tensor:
        width = left.shape[1]
        errors = [
            (left[:, shift:] - right[:, : width - shift]).abs().mean()
            for shift in range(self.settings.limit)
        ]
        best = int(torch.stack(errors).argmin())
        answer = torch.full(left.shape[:2], float(best))
        answer[:, :best] = torch.nan  # what the right image does not show
        return answer


class Middle(MultiViewDepthPrior[Settings]):
    """The middle of the bounds everywhere, but not at the first pixel."""

    asked = 0

    def estimate(self, views: Sequence[View], bounds: tuple[float, float]) -> list[DepthMap]:
        self.asked += 1
        maps = []
        for view in views:
            depth = torch.full(view.image.shape[:2], sum(bounds) / 2)
            depth[0, 0] = torch.inf
            maps.append(DepthMap(depth, depth > 0, torch.full_like(depth, 2.0)))
        return maps


class Brightness(MonocularDepthPrior[Settings]):
    """Bright is near."""

    asked = 0

    def estimate(self, image: Tensor) -> Tensor:
        self.asked += 1
        return image.mean(dim=2)


PriorType = TypeVar("PriorType", bound=Prior[Any])


def built(component: type[PriorType], name: str = "prior") -> PriorType:
    return component(component.Settings(), Context(name, 0, open_device()))


def textured(width: int = 40) -> Tensor:
    return torch.rand(24, width, 3, generator=torch.Generator().manual_seed(3))


@pytest.mark.parametrize("component", [BestShift, Middle, Brightness])
def test_they_keep_the_contract(component: type) -> None:
    check(component)


def test_disparity_of_a_shifted_pair_and_of_its_mirror_image() -> None:
    texture = textured()
    left, right = texture[:, :32], texture[:, 5:37]  # left(u) = right(u - 5)
    of_left, of_right = built(BestShift).both(left, right)
    assert of_left.valid[:, 5:].all()
    assert not of_left.valid[:, :5].any()
    assert (of_left.values[:, 5:] == 5).all()
    assert (of_left.values[:, :5] == 0).all()
    # The right image's first columns show what the left image shows five pixels further right.
    assert (of_right.values[:, :-5] == 5).all()
    assert not of_right.valid[:, -5:].any()


def test_the_pair_must_fit_together() -> None:
    with pytest.raises(PluginError, match="both must be"):
        built(BestShift).disparity(textured(32), textured(33))


@pytest.mark.parametrize("answer", [torch.tensor(1.0), torch.ones(24), 1.0, None])
def test_an_answer_of_another_shape_is_refused(
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
    def estimate(self, views: Sequence[View], bounds: tuple[float, float]) -> list[DepthMap]:
        return super().estimate(views, bounds)[:1]


class WrongShape(MonocularDepthPrior[Settings]):
    def estimate(self, image: Tensor) -> Tensor:
        return image.mean(dim=2)[1:]


def test_answers_of_the_wrong_number_or_shape_are_refused() -> None:
    scene = tiny_scene()
    with pytest.raises(PluginError, match="1 depth maps came for 2 views"):
        built(TooMany).depths(scene.train, scene.bounds)
    with pytest.raises(PluginError, match=r"expected a tensor of shape \(24, 32\)"):
        built(WrongShape).inverse_depth(scene.train[0].image)


def test_the_prior_with_the_capability_is_found_by_name_or_alone() -> None:
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


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("STEREOGS_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_the_same_question_is_answered_from_disk_bit_for_bit(cache: Path) -> None:
    scene = tiny_scene()
    first, second = built(Middle), built(Middle)
    before = first.depths(scene.train, scene.bounds)
    again = second.depths(scene.train, scene.bounds)
    assert (first.asked, second.asked) == (1, 0)
    for one, other in zip(before, again, strict=True):
        assert torch.equal(one.depth, other.depth)
        assert torch.equal(one.valid, other.valid)
        assert torch.equal(one.confidence, other.confidence)


def test_another_question_is_asked_anew(cache: Path) -> None:
    scene = tiny_scene()
    prior = built(Middle)
    prior.depths(scene.train, scene.bounds)
    prior.depths(scene.train, (scene.bounds[0], scene.bounds[1] * 2))
    prior.depths(scene.train[::-1], scene.bounds)
    assert prior.asked == 3
    mono = built(Brightness)
    mono.inverse_depth_of(scene.train[0])
    changed = scene.train[0].image.clone()
    changed[3, 3, 1] = torch.nextafter(changed[3, 3, 1], torch.tensor(1.0))
    mono.inverse_depth_of(replace(scene.train[0], image=changed))
    mono.inverse_depth_of(replace(scene.train[0], image=changed))
    assert mono.asked == 2


def test_cached_answers_can_be_looked_at(cache: Path) -> None:
    scene = tiny_scene()
    built(Middle, "sweep").depths(scene.train, scene.bounds)
    (folder,) = (cache / "sweep").iterdir()
    assert sorted(path.name for path in folder.iterdir()) == [
        "answer.json",
        "answer.safetensors",
        "checksum.txt",
        "view0_depth.png",
        "view2_depth.png",
    ]
    assert json.loads((folder / "answer.json").read_text())["views"] == ["view0", "view2"]
    assert set(load_file(folder / "answer.safetensors")) == {
        f"{i}/{name}" for i in range(2) for name in ("depth", "valid", "confidence")
    }


def test_a_damaged_answer_is_reported_and_replaced(
    cache: Path, caplog: pytest.LogCaptureFixture
) -> None:
    view = tiny_scene().train[0]
    prior = built(Brightness)
    answer = prior.inverse_depth_of(view)
    (file,) = cache.rglob("answer.safetensors")
    file.write_bytes(file.read_bytes()[:40])
    with caplog.at_level(logging.WARNING):
        assert torch.equal(prior.inverse_depth_of(view), answer)
    assert "damaged" in caplog.text
    assert prior.asked == 2
    prior.inverse_depth_of(view)
    assert prior.asked == 2


def test_a_cache_that_cannot_be_written_costs_a_warning_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("STEREOGS_CACHE", str(tmp_path / "file"))
    with caplog.at_level(logging.WARNING):
        built(Brightness).inverse_depth_of(tiny_scene().train[0])
    assert "could not be cached" in caplog.text


def test_a_full_disk_costs_a_warning_only(cache: Path, caplog: pytest.LogCaptureFixture) -> None:
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))  # as good as a full disk
    try:
        PriorCache("full").save("0" * 32, {"answer": torch.zeros(1000)}, {}, {})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert "could not be cached" in caplog.text
    assert PriorCache("full").load("0" * 32) is None


def test_the_code_of_the_component_is_part_of_the_question() -> None:
    assert code_digest(Middle) != code_digest(Brightness)
    assert code_digest(Middle) == code_digest(Middle)


@pytest.mark.parametrize("listed", ["top_level.txt", "RECORD"])
def test_the_code_of_all_that_its_package_installs_is_part_of_the_question(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, listed: str
) -> None:
    """Two modules side by side: a package that is no folder. A third belongs to somebody else."""
    name = listed.partition(".")[0].lower()
    modules = (f"flat_{name}", f"flat_{name}_helper")
    for module in (*modules, f"other_{name}"):
        (tmp_path / f"{module}.py").write_text("FACTOR = 1\n")
    metadata = tmp_path / f"flat_{name}-1.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: flat-{name}\nVersion: 1\n")
    (metadata / "entry_points.txt").write_text(f"[{GROUP}]\nflat = flat_{name}\n")
    lines = modules if listed == "top_level.txt" else [f"{module}.py,," for module in modules]
    (metadata / listed).write_text("\n".join(lines) + "\n")
    monkeypatch.syspath_prepend(tmp_path)
    component = type("Flat", (), {"__module__": f"flat_{name}"})

    def digest() -> str:
        source_digest.cache_clear()
        return code_digest(component)

    before = digest()
    (tmp_path / f"other_{name}.py").write_text("FACTOR = 2\n")
    assert digest() == before
    (tmp_path / f"flat_{name}_helper.py").write_text("FACTOR = 2\n")
    assert digest() != before


def test_a_stereo_prior_that_knows_nothing_is_told_of_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    class Nowhere(StereoPrior[Settings]):
        def estimate(self, left: Tensor, right: Tensor) -> Tensor:
            return torch.full(left.shape[:2], float("nan"))

    prior, image = built(Nowhere, "blind"), textured()
    for _ in range(2):
        assert not prior.disparity(image, image).valid.any()
    assert caplog.messages == ["prior 'blind' answered without one known disparity"]


def test_an_answer_about_an_image_is_not_kept(cache: Path) -> None:
    prior, image = built(Brightness), tiny_scene().train[0].image
    assert torch.equal(prior.inverse_depth(image), prior.inverse_depth(image))
    assert prior.asked == 2
    assert not cache.exists() or not list(cache.rglob("*.safetensors"))


class Torch(MonocularDepthPrior[Settings]):
    """Brightness, in autograd."""

    differentiable = True

    def estimate(self, image: Tensor) -> Tensor:
        return image.mean(dim=2)


def test_a_differentiable_prior_lets_gradients_through() -> None:
    image = torch.rand(4, 5, 3, requires_grad=True)
    built(Torch).inverse_depth(image).sum().backward()
    assert image.grad is not None
    torch.testing.assert_close(image.grad, torch.full((4, 5, 3), 1 / 3))
    assert not built(Brightness).inverse_depth(image).requires_grad


class Sideways(OpticalFlowPrior[Settings]):
    """Three pixels to the right; the first pixel is not known."""

    asked = 0

    def estimate(self, first: Tensor, second: Tensor) -> Tensor:
        self.asked += 1
        flow = torch.zeros(*first.shape[:2], 2)
        flow[..., 0] = 3
        flow[0, 0] = torch.nan
        return flow


class Corners(MatchingPrior[Settings]):
    """The corners of the images; one of the matches lies outside, one score is too high."""

    asked = 0

    def estimate(self, first: Tensor, second: Tensor) -> Matches:
        self.asked += 1
        points = torch.tensor([[0.0, 0.0], [1.0, 1.0], [1e4, 1.0]])
        return Matches(points, points, torch.tensor([0.5, 7.0, 0.5]))


def test_a_flow_is_checked_and_remembered_between_views(cache: Path) -> None:
    check(Sideways)
    (first, second), prior = tiny_scene().train, built(Sideways)
    flow = prior.flow_between(first, second)
    assert torch.equal(prior.flow_between(first, second).vectors, flow.vectors)
    assert prior.asked == 1
    assert not flow.valid[0, 0]
    assert int(flow.valid.sum()) == flow.valid.numel() - 1
    assert flow.vectors[0, 0].tolist() == [0, 0]
    assert flow.vectors[3, 4].tolist() == [3, 0]
    prior.flow(first.image, second.image)
    assert prior.asked == 2


def test_matches_are_checked_and_remembered_between_views(cache: Path) -> None:
    check(Corners)
    (first, second), prior = tiny_scene().train, built(Corners)
    matches = prior.matches_between(first, second)
    assert prior.matches_between(first, second).first.tolist() == [[0, 0], [1, 1]]
    assert matches.scores.tolist() == [0.5, 1]
    assert prior.asked == 1


class Crooked(MatchingPrior[Settings]):
    def estimate(self, first: Tensor, second: Tensor) -> Matches:
        return Matches(torch.zeros(3, 2), torch.zeros(2, 2), torch.zeros(3))


class Narrow(OpticalFlowPrior[Settings]):
    def estimate(self, first: Tensor, second: Tensor) -> Tensor:
        return first


def test_answers_of_the_wrong_shape_are_refused() -> None:
    image = torch.rand(4, 5, 3)
    with pytest.raises(
        PluginError, match="second is \\(2, 2\\), expected a tensor of shape \\(3, 2\\)"
    ):
        built(Crooked).matches(image, image)
    with pytest.raises(PluginError, match="expected a tensor of shape \\(4, 5, 2\\)"):
        built(Narrow).flow(image, image)
