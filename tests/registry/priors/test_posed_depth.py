"""Priors of cameras and depth: checks of answers, pointmaps, cache."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from registry import PluginError, Settings
from registry.priors import PosedDepth, PosedDepthPrior
from registry.testing import check, tiny_scene
from tests.registry.priors.toy_priors import built


class Row(PosedDepthPrior[Settings]):
    """Cameras in a row before a wall; the first depth is unknown."""

    calls = 0

    def estimate(
        self, images: Sequence[Tensor], intrinsics: Sequence[Tensor | None]
    ) -> list[PosedDepth]:
        self.calls += 1
        return [self.view(k, image) for k, image in enumerate(images)]

    def view(self, index: int, image: Tensor) -> PosedDepth:
        height, width = image.shape[:2]
        pose = torch.eye(4)
        pose[0, 3] = -0.2 * index
        lens = torch.tensor([[30.0, 0, width / 2], [0, 30, height / 2], [0, 0, 1]])
        depth = 3 + image.mean(dim=2)
        depth[0, 0] = torch.nan
        return PosedDepth(pose, lens, depth, torch.full_like(depth, 0.5))


class Logits(Row):
    confidences = "logits"


class Few(Row):
    accepted_views = (3, 4)


IMAGES = [view.image for view in tiny_scene().train]
UNKNOWN: list[Tensor | None] = [None, None]


@pytest.mark.parametrize("component", [Row, Logits, Few])
def test_priors_of_cameras_keep_the_contract(component: type[Row]) -> None:
    check(component)


def test_the_answer_is_checked_and_cached(cache: Path) -> None:
    prior = built(Row)
    first, second = prior.posed_depths(IMAGES, UNKNOWN)
    assert torch.equal(prior.posed_depths(IMAGES, UNKNOWN)[1].depth, second.depth)
    assert prior.calls == 1
    assert second.world_to_camera[0, 3] == pytest.approx(-0.2)
    assert first.depth[0, 0] == first.confidence[0, 0] == 0
    assert first.confidence[1, 1] == 0.5
    assert built(Logits).posed_depths(IMAGES, UNKNOWN)[0].confidence[1, 1] == pytest.approx(
        0.6225, 1e-3
    )
    # Known intrinsics, and other photographs, are other questions.
    prior.posed_depths(IMAGES, [torch.eye(3), None])
    prior.posed_depths(IMAGES[::-1], UNKNOWN)
    assert prior.calls == 3


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"depth": torch.ones(3, 4)}, r"depth is \(3, 4\), expected a tensor of shape \(24, 32\)"),
        ({"world_to_camera": torch.eye(3)}, r"world_to_camera is \(3, 3\)"),
        ({"world_to_camera": 2 * torch.eye(4)}, "camera of photograph 0 is not valid"),
        ({"world_to_camera": torch.full((3, 4), torch.nan)}, "camera of photograph 0 is not valid"),
        ({"intrinsics": torch.zeros(3, 3)}, "camera of photograph 0 is not valid"),
        ({"confidence": torch.full((24, 32), 7.0)}, "not 0 to 1"),
        ({"confidence": torch.linspace(-0.5, 1, 24 * 32).reshape(24, 32)}, "not 0 to 1"),
    ],
)
def test_a_wrong_answer_is_refused(
    change: dict[str, Tensor], what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    right = Row.view
    monkeypatch.setattr(Row, "view", lambda *given: replace(right(*given), **change))
    with pytest.raises(PluginError, match=what):
        built(Row).posed_depths(IMAGES, UNKNOWN)


@pytest.mark.parametrize("answer", [None, [], [1, 2]])
def test_an_answer_of_another_type_or_length_is_refused(
    answer: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Row, "estimate", lambda *given: answer)
    with pytest.raises(PluginError, match="expected a"):
        built(Row).posed_depths(IMAGES, UNKNOWN)


def test_the_number_of_photographs_must_be_accepted() -> None:
    with pytest.raises(PluginError, match="accepts 3 to 4 photographs, and got 2"):
        built(Few).posed_depths(IMAGES, UNKNOWN)
    with pytest.raises(PluginError, match="accepts 2 or more photographs, and got 1"):
        built(Row).posed_depths(IMAGES[:1], UNKNOWN[:1])


def test_impossible_numbers_of_photographs_do_not_pass_the_check(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Few, "accepted_views", (4, 3))
    with pytest.raises(AssertionError, match="`accepted_views` is 4 to 3"):
        check(Few)


def test_the_example_of_the_docs_keeps_the_contract() -> None:
    page = (Path(__file__).parents[3] / "docs" / "prior_models.md").read_text("utf-8")
    (source,) = re.findall(r"```py\n(.*?PosedDepthPrior.*?)```", page, re.DOTALL)
    scope: dict[str, Any] = {"__name__": "example"}
    exec(source, scope)
    check(scope["Wall"])


def test_a_pointmap_gives_depth_and_focal_length() -> None:
    camera = tiny_scene().test[0].camera
    rows, columns = torch.meshgrid(torch.arange(24) + 0.5, torch.arange(32) + 0.5, indexing="ij")
    depth = 2 + rows / 24
    points = camera.unproject(columns, rows, depth)
    points[0, 0] = torch.inf
    answer = PosedDepth.from_points(points, camera.world_to_camera, torch.ones(24, 32))
    assert torch.allclose(answer.depth[1:].float(), depth[1:])
    assert torch.allclose(answer.intrinsics, camera.intrinsics)
    one = PosedDepth.from_points(points[:1, 1:2], camera.world_to_camera, torch.ones(1, 1))
    assert one.intrinsics.diagonal().tolist() == [1, 1, 1]
