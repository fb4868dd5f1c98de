"""Prior models by capability: the question is checked, the answer is cleaned, the right one is found."""

from __future__ import annotations

import json
import logging
from collections.abc import Sequence
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
    MonocularDepthPrior,
    MultiViewDepthPrior,
    PluginError,
    Prior,
    Settings,
    StereoPrior,
    View,
)
from registry.priors.prior_cache import code_digest
from registry.testing import check, tiny_scene


class ShiftSettings(Settings):
    limit: int = 8
    """Largest shift tried, in pixels."""


class BestShift(StereoPrior[ShiftSettings]):
    """The one shift that explains the whole image best, at every pixel."""

    Settings = ShiftSettings

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
    mono.inverse_depth(scene.train[0].image)
    changed = scene.train[0].image.clone()
    changed[3, 3, 1] = torch.nextafter(changed[3, 3, 1], torch.tensor(1.0))
    mono.inverse_depth(changed)
    mono.inverse_depth(changed)
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
    image = tiny_scene().train[0].image
    prior = built(Brightness)
    answer = prior.inverse_depth(image)
    (file,) = cache.rglob("answer.safetensors")
    file.write_bytes(file.read_bytes()[:40])
    with caplog.at_level(logging.WARNING):
        assert torch.equal(prior.inverse_depth(image), answer)
    assert "damaged" in caplog.text
    assert prior.asked == 2
    prior.inverse_depth(image)
    assert prior.asked == 2


def test_a_cache_that_cannot_be_written_costs_a_warning_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("STEREOGS_CACHE", str(tmp_path / "file"))
    with caplog.at_level(logging.WARNING):
        built(Brightness).inverse_depth(tiny_scene().train[0].image)
    assert "could not be cached" in caplog.text


def test_the_code_of_the_component_is_part_of_the_question() -> None:
    assert code_digest(Middle) != code_digest(Brightness)
    assert code_digest(Middle) == code_digest(Middle)
