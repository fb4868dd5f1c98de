"""Matching networks, with graphs whose keypoints are bright pixels that match by brightness."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch import Tensor

from core_rasterizer import Camera
from registry import PluginError, View
from registry.priors import Matches
from registry.testing import check
from registry.toolkit.views import epipolar_distances
from stereogs_plugins.priors.onnx_matching import OnnxMatching, stereogs_register_priors
from stereogs_plugins.scenes.llff import LLFFScene
from tests.data import data_folder, models_folder
from tests.stereogs_plugins.building import build, offered
from tests.stereogs_plugins.priors import graphs

FIRST = [(3, 4), (30, 9), (21, 17)]
SECOND = [(36, 20), (5, 1), (11, 12)]


def dotted(places: list[tuple[int, int]], scale: int = 1) -> Tensor:
    """A dark image `[24 s, 40 s, 3]` with dots of s x s pixels at (column, row), the first the brightest."""
    image = torch.zeros(24, 40, 3)
    for brightness, (column, row) in zip((0.9, 0.7, 0.5), places, strict=True):
        image[row, column] = brightness
    return image.repeat_interleave(scale, 0).repeat_interleave(scale, 1)


def centers(places: list[tuple[int, int]], scale: int = 1) -> Tensor:
    return scale * (torch.tensor(places) + 0.5)


def matching(folder: Path, size: tuple[int, int] = (24, 40), **settings: object) -> OnnxMatching:
    """With a graph of a frozen size (height, width)."""
    finder = graphs.brightest_pixels(folder / "finder.onnx", *size)
    matcher = graphs.matcher_of_points(folder / "matcher.onnx")
    return build(OnnxMatching, model=finder, matcher=matcher, **settings)


def test_is_registered_and_keeps_the_contract(tmp_path: Path) -> None:
    assert offered(stereogs_register_priors) == {"onnx_matching": OnnxMatching}
    matching(tmp_path)
    check(OnnxMatching, model=tmp_path / "finder.onnx", matcher=tmp_path / "matcher.onnx")


@pytest.mark.parametrize("size", [(24, 40), (40, 24)])
@pytest.mark.parametrize("scale", [1, 2])
def test_points_are_mapped_back_from_the_graphs_size_and_orientation(
    tmp_path: Path, size: tuple[int, int], scale: int
) -> None:
    found = matching(tmp_path, size).matches(dotted(FIRST, scale), dotted(SECOND, scale))
    assert torch.allclose(found.first, centers(FIRST, scale))
    assert torch.allclose(found.second, centers(SECOND, scale))
    assert (found.scores > 0.99).all()


def test_the_matcher_gets_centred_points(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    prior = matching(tmp_path)
    given: dict[str, Tensor] = {}
    matcher = prior._networks._matcher
    run = matcher.run
    monkeypatch.setattr(matcher, "run", lambda inputs: given.update(inputs) or run(inputs))
    prior.matches(dotted(FIRST), dotted(SECOND))
    expected = torch.tensor([[(u - 20) / 20, (v - 12) / 20] for u, v in SECOND])
    assert torch.allclose(given["kpts1"], expected[None])
    assert torch.allclose(given["desc0"].flatten(), torch.tensor([0.9, 0.7, 0.5]))


def test_matches_of_low_score_are_dropped(tmp_path: Path) -> None:
    paler = dotted(SECOND)
    paler[1, 5] = 0.62  # the second dot, 0.7 in the first image
    scores = matching(tmp_path, min_score=0.0).matches(dotted(FIRST), paler).scores
    assert torch.allclose(scores, torch.tensor([1.0, 0.92, 1.0]), atol=1e-6)
    found = matching(tmp_path, min_score=0.95).matches(dotted(FIRST), paler)
    assert torch.allclose(found.first, centers([FIRST[0], FIRST[2]]))


def test_matches_of_photographs_are_near_the_epipolar_lines(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two cameras side by side: what moved by more than two rows cannot be the same point."""
    monkeypatch.setenv("STEREOGS_CACHE", "")
    left = Camera.centered(torch.eye(4), 40.0, 40, 24)
    second = [(1, 4), (28, 11), (20, 20)]  # moved by 0, 2 and 3 rows
    views = [
        View("left", left, dotted(FIRST)),
        View("right", left.shifted_right(0.5), dotted(second)),
    ]
    found = matching(tmp_path, max_epipolar_distance=2.5).matches_between(*views)
    assert torch.allclose(found.second, centers(second[:2]))
    distances = epipolar_distances(found, views[0].camera, views[1].camera)
    assert torch.allclose(distances, torch.tensor([0.0, 2.0], dtype=torch.float64), atol=1e-4)
    assert len(matching(tmp_path, max_epipolar_distance=None).matches_between(*views).scores) == 3
    same_place = matching(tmp_path).matches_between(views[0], View("again", left, dotted(second)))
    assert len(same_place.scores) == 3  # no parallax, no line, nothing to hold against it


def test_epipolar_distances_are_those_to_the_projected_ray() -> None:
    """Any two cameras: a point's projections have none, one moved along the normal its length."""
    first = Camera.look_at((0, 0, 0), (0.2, 0.1, 3), 50.0, 64, 48)
    second = Camera.look_at((1.0, -0.3, 0.4), (0, 0, 3), 60.0, 64, 48)
    point = torch.tensor([[0.3, 0.2, 2.5]], dtype=torch.float64)
    near, far = (
        torch.stack(second.project(first.center + s * (point - first.center))[:2], dim=1)
        for s in (1, 4)
    )
    normal = (far - near).flip(1) * torch.tensor([1.0, -1.0])
    moved = near + 3 * normal / normal.norm()
    here = torch.stack(first.project(point)[:2], dim=1)
    score = torch.ones(1)
    assert float(epipolar_distances(Matches(here, near, score), first, second)) < 1e-9
    there = epipolar_distances(Matches(here, moved, score), first, second)
    assert float(there) >= 3 - 1e-9
    back = epipolar_distances(Matches(moved, here, score), second, first)
    assert float(back) == pytest.approx(float(there))


def test_files_and_outputs_are_checked(tmp_path: Path) -> None:
    finder = graphs.brightest_pixels(tmp_path / "finder.onnx", 24, 40)
    matcher = graphs.matcher_of_points(tmp_path / "matcher.onnx")
    with pytest.raises(PluginError, match="4 inputs; its name must be specified"):
        build(OnnxMatching, model=matcher, matcher=finder)
    with pytest.raises(PluginError, match="no input 'kpts0'"):
        build(OnnxMatching, model=finder, matcher=finder)
    with pytest.raises(PluginError, match="SHA-256"):
        build(OnnxMatching, model=finder, matcher=matcher, matcher_sha256="0" * 64)
    with pytest.raises(PluginError, match="no output 'keypoints'"):
        build(OnnxMatching, model=graphs.mono(tmp_path / "mono.onnx"), matcher=matcher)
    beyond = graphs.matcher_of_points(tmp_path / "beyond.onnx", beyond=1)
    with pytest.raises(PluginError, match=r"are not pairs of the \[3, 3\] keypoints"):
        build(OnnxMatching, model=finder, matcher=beyond).matches(dotted(FIRST), dotted(SECOND))


@pytest.mark.proof
def test_xfeat_and_lighterglue_on_fern() -> None:
    folder = models_folder("xfeat")
    scene = build(LLFFScene, path=data_folder("llff_fern"), train_views=3).load()
    prior = build(
        OnnxMatching,
        model=folder / "xfeat_2048_640x360.onnx",
        matcher=folder / "lighterglue_L3.onnx",
    )
    first, second = scene.train[1:]
    found = prior.matches(first.image, second.image)
    assert len(found.scores) > 1000
    assert epipolar_distances(found, first.camera, second.camera).median() < 1.1
