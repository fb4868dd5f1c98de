"""The plane sweep on scenes with known depth, and its errors."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pydantic
import pytest
import torch
from torch import Tensor

from registry import PluginError, Scene, View
from registry.priors import DepthMap
from stereogs_plugins.priors.plane_sweep import PlaneSweep, stereogs_register_priors
from stereogs_plugins.scenes.llff import LLFFScene
from tests.data import data_folder
from tests.host import point_errors, reconstructed
from tests.stereogs_plugins.building import build, offered
from tests.stereogs_plugins.priors import graphs

PLANES = 64
"""Few planes, enough for small images."""


@pytest.fixture(scope="module")
def room(procedural_room: Scene) -> Scene:
    """Three training views of the ray-cast room with exact depth."""
    return replace(procedural_room, test=())


@pytest.fixture(scope="module")
def answers(room: Scene) -> list[DepthMap]:
    """Results for the room with default settings but fewer planes."""
    return build(PlaneSweep, planes=PLANES).depths(room.train, room.bounds)


def share_within(depth: Tensor, truth: Tensor, where: Tensor, relative: float) -> float:
    """Share of the pixels with the true depth within a relative error."""
    return float(((depth - truth).abs() < relative * truth)[where].float().mean())


def scores(maps: list[DepthMap], scene: Scene, relative: float) -> list[float]:
    """For each view, the share of valid pixels with a correct depth."""
    result = []
    for answer, view in zip(maps, scene.train, strict=True):
        assert view.depth is not None
        known = answer.valid & (view.depth > 0)
        result.append(share_within(answer.depth, view.depth, known, relative))
    return result


def test_the_plugin_registers_it() -> None:
    assert offered(stereogs_register_priors) == {"plane_sweep": PlaneSweep}


def test_the_depth_of_a_room_is_found(room: Scene, answers: list[DepthMap]) -> None:
    """The outer views see a tenth of the room alone; the middle one sees little alone."""
    assert min(float(answer.valid.float().mean()) for answer in answers) > 0.95
    within_2, within_10 = scores(answers, room, 0.02), scores(answers, room, 0.1)
    assert min(within_2) > 0.78
    assert within_2[1] > 0.88
    assert min(within_10) > 0.86
    assert within_10[1] > 0.94


def test_confidence_separates_right_from_wrong_depths(room: Scene, answers: list[DepthMap]) -> None:
    answer, truth = answers[1], room.train[1].depth
    assert truth is not None
    right = ((answer.depth - truth).abs() < 0.05 * truth) & answer.valid
    wrong = ~right & answer.valid
    assert answer.confidence[right].mean() > 1.5 * answer.confidence[wrong].mean()


def test_two_runs_give_the_same_bits(room: Scene, answers: list[DepthMap]) -> None:
    again = build(PlaneSweep, 1, planes=PLANES).depths(room.train, room.bounds)
    for one, other in zip(answers, again, strict=True):
        assert torch.equal(one.depth, other.depth)
        assert torch.equal(one.confidence, other.confidence)


def test_views_may_differ_in_size_and_principal_point(room: Scene) -> None:
    """The second view cropped, which moves its principal point."""
    first, second, third = room.train
    camera = replace(
        second.camera,
        cx=second.camera.cx - 30,
        cy=second.camera.cy - 20,
        width=second.camera.width - 40,
        height=second.camera.height - 25,
    )
    cut = np.s_[20:-5, 30:-10]
    assert second.depth is not None
    cropped = View(second.name, camera, second.image[cut], depth=second.depth[cut])
    scene = replace(room, train=(first, cropped, third))
    maps = build(PlaneSweep, planes=PLANES).depths(scene.train, room.bounds)
    assert maps[1].depth.shape == cropped.image.shape[:2]
    assert min(scores(maps, scene, 0.02)) > 0.75


def test_sources_are_the_nearest_views_at_other_positions(room: Scene) -> None:
    here, there = room.train[:2]
    far = replace(there, name="far", camera=room.train[2].camera.shifted_right(50))
    twin = replace(here, name="twin")

    def first_depth(*views: View, **settings: object) -> Tensor:
        prior = build(PlaneSweep, planes=PLANES, **settings)
        return prior.depths((here, there, *views), room.bounds)[0].depth

    alone = first_depth()
    assert torch.equal(first_depth(twin), alone)
    assert torch.equal(first_depth(far, max_sources=1), alone)
    assert not torch.equal(first_depth(room.train[2]), alone)


def test_one_view_is_refused(room: Scene) -> None:
    with pytest.raises(PluginError, match="needs two views"):
        build(PlaneSweep).depths(room.train[:1], room.bounds)


def test_features_from_a_file_give_the_cost(room: Scene, tmp_path: Path) -> None:
    file = graphs.grey_features(tmp_path / "model.onnx")
    prior = build(PlaneSweep, planes=PLANES, cost="features", features=file)
    maps = prior.depths(room.train, room.bounds)
    # Grey alone is a poor feature: most of the room is found all the same.
    assert min(scores(maps, room, 0.1)) > 0.5
    assert prior.fingerprint() != build(PlaneSweep, planes=PLANES).fingerprint()


def test_settings_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    with pytest.raises(pydantic.ValidationError, match="require each other"):
        build(PlaneSweep, cost="features")
    with pytest.raises(pydantic.ValidationError, match="require each other"):
        build(PlaneSweep, features=tmp_path / "model.onnx")
    with pytest.raises(pydantic.ValidationError, match="at least `small_penalty`"):
        build(PlaneSweep, small_penalty=20, large_penalty=10)
    with pytest.raises(PluginError, match="cannot be read"):
        build(PlaneSweep, cost="features", features=tmp_path / "missing.onnx")


@pytest.mark.proof
@pytest.mark.parametrize(
    ("name", "least"),
    [("llff_fern", (0.73, 0.91, 0.95)), ("llff_flower", (0.37, 0.68, 0.91))],
)
def test_real_photographs(name: str, least: tuple[float, float, float]) -> None:
    """Against points of the reconstruction from all photographs; see benchmarks/priors_depth.py."""
    scene = build(LLFFScene, path=data_folder(name), train_views=3).load()
    maps = build(PlaneSweep).depths(scene.train, scene.bounds)
    seen = reconstructed(data_folder(name) / "points3d.npz", scene)
    errors = point_errors(scene, seen, [answer.depth.numpy() for answer in maps])
    for relative, share in zip((0.01, 0.03, 0.1), least, strict=True):
        assert (errors < relative).mean() > share
