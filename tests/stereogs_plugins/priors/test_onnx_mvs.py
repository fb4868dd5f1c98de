"""Multi-view networks, with graphs that return one number of their inputs as depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from core_rasterizer import Camera
from registry import PluginError, View
from registry.priors import DepthMap
from registry.toolkit.views import view_overlap
from stereogs_plugins.priors.onnx_mvs import OnnxMvs, stereogs_register_priors
from tests.stereogs_plugins.building import build, offered
from tests.stereogs_plugins.priors import graphs

BOUNDS = (1.5, 9.0)


def mvs(model: Path, **settings: object) -> OnnxMvs:
    return build(OnnxMvs, model=model, **settings)


def three_views(width: int = 50, height: int = 40) -> list[View]:
    """Cameras at x = 0, 3 and -1 that look along z; the picture's brightness tells which it is."""
    views = []
    for index, x in enumerate((0.0, 3.0, -1.0)):
        pose = torch.eye(4, dtype=torch.float64)
        pose[0, 3] = -x
        camera = Camera(pose, 45.0, 46.0, 26.0, 19.0, width, height)
        image = torch.full((height, width, 3), 0.2 + 0.3 * index)
        views.append(View(f"view{index}", camera, image))
    return views


def asked(path: Path, views: Sequence[View] | None = None, **settings: object) -> list[DepthMap]:
    return mvs(path, **settings).depths(views or three_views(), BOUNDS)


def depth_of(answer: DepthMap) -> float:
    """The constant depth of a map."""
    assert answer.valid.all()
    assert torch.allclose(answer.depth, answer.depth[0, 0])
    return float(answer.depth[0, 0])


def test_registers_as_onnx_mvs() -> None:
    assert offered(stereogs_register_priors) == {"onnx_mvs": OnnxMvs}


@pytest.mark.parametrize(
    ("index", "expected"),
    [((0, 0, 0), 45 * 64 / 50), ((0, 1, 1), 46 * 32 / 40), ((0, 0, 2), 26 * 64 / 50)],
)
def test_intrinsics_are_scaled_with_the_images_to_multiples_of_32(
    tmp_path: Path, index: tuple[int, ...], expected: float
) -> None:
    """50x40 becomes 64x32, the nearest multiples of 32."""
    path = graphs.pick(tmp_path / "m.onnx", "K", index)
    for answer in asked(path):
        assert answer.depth.shape == (40, 50)
        assert depth_of(answer) == pytest.approx(expected, rel=1e-6)


def test_intrinsics_can_be_for_a_quarter_of_the_size(tmp_path: Path) -> None:
    focal = graphs.pick(tmp_path / "f.onnx", "K", (1, 1, 1))
    assert depth_of(asked(focal, intrinsics="quarter")[0]) == pytest.approx(46 * 32 / 40 / 4)
    last = graphs.pick(tmp_path / "one.onnx", "K", (1, 2, 2))
    assert depth_of(asked(last, intrinsics="quarter")[0]) == 1


def test_the_reference_view_is_first_and_sources_follow_by_distance(tmp_path: Path) -> None:
    """The cameras are at 0, 3 and -1."""
    order = []
    for place in range(3):
        path = graphs.pick(tmp_path / f"{place}.onnx", "images", (place, 0))
        answers = asked(path, value_range="0..1", min_overlap=0.0)
        order.append([round((depth_of(answer) - 0.2) / 0.3) for answer in answers])
    assert list(zip(*order, strict=True)) == [(0, 2, 1), (1, 0, 2), (2, 0, 1)]


def test_poses_are_world_to_camera_in_the_same_order(tmp_path: Path) -> None:
    views = three_views()
    for view in views:  # a positive translation, as depths must be positive
        view.camera.world_to_camera[0, 3] += 10
    found = [
        [
            depth_of(a)
            for a in asked(graphs.pick(tmp_path / "m.onnx", "cam_T_world", (n, 0, 3)), views)
        ]
        for n in range(2)
    ]
    assert found == [[10, 7, 11], [11, 10, 10]]


def test_the_depth_range_is_passed_if_it_is_an_input(tmp_path: Path) -> None:
    for place, bound in enumerate(BOUNDS):
        path = graphs.pick(tmp_path / "m.onnx", "depth_range", (place,))
        assert depth_of(asked(path)[0]) == bound
    without = graphs.pick(tmp_path / "w.onnx", "K", (0, 2, 2), depth_range=False)
    assert depth_of(asked(without)[0]) == 1


def test_images_are_normalized_as_imagenet(tmp_path: Path) -> None:
    path = graphs.pick(tmp_path / "m.onnx", "images", (0, 2))
    bright = [replace(v, image=torch.full_like(v.image, 0.9)) for v in three_views()]
    assert depth_of(asked(path, bright)[0]) == pytest.approx((0.9 - 0.406) / 0.225, rel=1e-5)


def test_confidence_is_the_graph_s_or_one(tmp_path: Path) -> None:
    path = graphs.pick(tmp_path / "m.onnx", "K", (0, 0, 0))
    assert (asked(path)[0].confidence == 0.5).all()
    path = graphs.pick(tmp_path / "m.onnx", "K", (0, 0, 0), confidence=None)
    assert (asked(path)[0].confidence == 1).all()


def test_depth_is_resized_to_the_image(tmp_path: Path) -> None:
    """100 columns become 96 and 100 again: a slope stays a slope, and what is unknown stays so."""
    path = graphs.pick(tmp_path / "m.onnx", "images", (0, 0))
    slope = torch.linspace(0.2, 0.8, 100)[None, :, None].expand(64, 100, 3).clone()
    slope[:20] = 0
    views = [replace(v, image=slope) for v in three_views(100, 64)]
    answer = asked(path, views, value_range="0..1")[0]
    assert (answer.depth[20:, 2:-2] - slope[20:, 2:-2, 0]).abs().max() < 2e-3
    assert not answer.valid[:20].any()
    assert answer.valid[20:].all()
    assert (answer.confidence[:20] == 0).all()


def test_depths_that_are_not_positive_are_not_mixed_with_others(tmp_path: Path) -> None:
    """The graph answers -1 on the left and 1 on the right, with -0.75 and 0.75 at the border."""
    path = graphs.pick(tmp_path / "m.onnx", "images", (0, 0))
    halves = torch.zeros(32, 64, 3)
    halves[:, 32:] = 1
    views = [replace(v, image=halves) for v in three_views(64, 32)]
    answer = asked(path, views, value_range="-1..1", size=(32, 32))[0]
    assert not answer.valid[:, :32].any()
    assert answer.valid[:, 32:].all()
    assert answer.depth[:, 32:].min() > 0.7


def test_a_depth_without_confidence_is_still_a_depth(tmp_path: Path) -> None:
    path = graphs.pick(tmp_path / "m.onnx", "K", (0, 0, 0), confidence=0.0)
    answer = asked(path)[0]
    assert answer.valid.all()
    assert (answer.confidence == 0).all()


def test_views_are_resized_to_the_reference_view(tmp_path: Path) -> None:
    views = [*three_views()[:2], three_views(100, 80)[2]]
    own = graphs.pick(tmp_path / "own.onnx", "K", (0, 0, 0))
    assert [depth_of(a) for a in asked(own, views)] == pytest.approx(
        [45 * 64 / 50, 45 * 64 / 50, 45 * 96 / 100]
    )
    neighbour = graphs.pick(tmp_path / "other.onnx", "K", (1, 0, 0))  # view 2 is nearest to view 0
    answers = asked(neighbour, views)
    assert depth_of(answers[0]) == pytest.approx(45 * 64 / 100)
    assert answers[2].depth.shape == (80, 100)


def test_sources_are_limited_and_a_graph_can_fix_their_number(tmp_path: Path) -> None:
    third = graphs.pick(tmp_path / "m.onnx", "images", (2, 0))
    with pytest.raises(PluginError, match="the model failed"):  # there is no third view to look at
        asked(third, max_sources=1)
    path = graphs.pick(tmp_path / "two.onnx", "K", (1, 2, 2), views=2)
    assert depth_of(asked(path)[0]) == 1
    path = graphs.pick(tmp_path / "eight.onnx", "K", (0, 0, 0), views=8)
    with pytest.raises(PluginError, match="takes 8 views, but there are 3"):
        asked(path)


def test_a_view_without_overlap_is_not_a_source(tmp_path: Path) -> None:
    """View 2, the nearest to view 0, turns away; view 0 is then shown view 1 alone."""
    views = three_views()
    away = views[2].camera.world_to_camera
    away[:3] = torch.diag(torch.tensor([-1.0, 1, -1], dtype=torch.float64)) @ away[:3]
    second = graphs.pick(tmp_path / "m.onnx", "images", (1, 0))
    first, other, turned = asked(second, views, value_range="0..1")
    assert round((depth_of(first) - 0.2) / 0.3) == 1
    assert round((depth_of(other) - 0.2) / 0.3) == 0
    assert not turned.valid.any()
    assert (turned.depth == 0).all()
    # A graph that insists on its number of views is given the others behind those that help.
    third = graphs.pick(tmp_path / "three.onnx", "images", (2, 0), views=3)
    first = asked(third, views, value_range="0..1")[0]
    assert round((depth_of(first) - 0.2) / 0.3) == 2


def test_overlap_of_shifted_cameras() -> None:
    pose = torch.eye(4, dtype=torch.float64)
    camera = Camera(pose, 50.0, 50.0, 25.0, 20.0, 50, 40)
    assert view_overlap(camera, camera, BOUNDS) == 1
    # Half the width of what is seen at the distance 2, to the right: half is left.
    assert view_overlap(camera, camera.shifted_right(1.0), (2.0, 2.0)) == pytest.approx(
        0.5, abs=0.05
    )
    assert view_overlap(camera, camera.shifted_right(100.0), BOUNDS) == 0


def test_depth_of_low_confidence_is_unknown(tmp_path: Path) -> None:
    path = graphs.pick(tmp_path / "m.onnx", "K", (0, 0, 0), confidence=0.5)
    assert asked(path, min_confidence=0.5)[0].valid.all()
    unsure = asked(path, min_confidence=0.51)[0]
    assert not unsure.valid.any()
    assert (unsure.confidence == 0).all()
    silent = graphs.pick(tmp_path / "s.onnx", "K", (0, 0, 0), confidence=None)
    with pytest.raises(PluginError, match="no output 'conf'"):
        mvs(silent, min_confidence=0.3)


def test_large_images_are_shrunk_unless_size_is_set(tmp_path: Path) -> None:
    path = graphs.pick(tmp_path / "m.onnx", "K", (0, 0, 0))
    views = three_views(300, 150)
    assert depth_of(asked(path, views, max_side=128)[0]) == pytest.approx(45 * 128 / 300)
    assert depth_of(asked(path, views, max_side=128, size=(192, 96))[0]) == pytest.approx(
        45 * 192 / 300
    )


def test_size_sets_the_input_size(tmp_path: Path) -> None:
    path = graphs.pick(tmp_path / "m.onnx", "K", (0, 0, 0))
    assert depth_of(asked(path, size=(96, 64))[0]) == pytest.approx(45 * 96 / 50)
    assert depth_of(asked(path, multiple=8)[0]) == pytest.approx(45 * 48 / 50)


@pytest.mark.parametrize(
    ("stage", "factor"), [("stage1", 0.125), ("stage2", 0.25), ("stage3", 0.5), ("stage4", 1)]
)
def test_mvsformer_has_intrinsics_of_each_stage(tmp_path: Path, stage: str, factor: float) -> None:
    """80x100 becomes 64x128, the nearest multiples of 64."""
    views = three_views(100, 80)
    focal = graphs.pick_staged(tmp_path / "m.onnx", stage, (0, 1, 0, 0))
    answers = asked(focal, views, family="mvsformer")
    assert depth_of(answers[0]) == pytest.approx(45 * 128 / 100 * factor)
    assert (answers[0].confidence == 0.5).all()
    last = graphs.pick_staged(tmp_path / "one.onnx", stage, (0, 1, 2, 2))
    assert depth_of(asked(last, views, family="mvsformer")[0]) == 1
    pose = graphs.pick_staged(tmp_path / "pose.onnx", stage, (2, 0, 0, 3))
    assert depth_of(asked(pose, views, family="mvsformer")[1]) == 1  # view 2 stands at x = -1


def test_mvsformer_gets_depths_from_near_to_far(tmp_path: Path) -> None:
    for place, expected in ((0, 1.5), (191, 9.0), (1, 1.5 + 7.5 / 191)):
        path = graphs.pick_staged(tmp_path / "m.onnx", "depth_values", (place,))
        assert depth_of(asked(path, family="mvsformer")[0]) == pytest.approx(expected)


def test_the_model_is_part_of_the_cache_key(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STEREOGS_CACHE", str(tmp_path / "cache"))
    path = graphs.pick(tmp_path / "m.onnx", "K", (0, 0, 0))
    first = mvs(path)
    assert first.fingerprint() == mvs(path).fingerprint()
    before = depth_of(first.depths(three_views(), BOUNDS)[0])
    graphs.pick(path, "K", (0, 1, 1))
    second = mvs(path)  # the same settings, another file
    assert second.fingerprint() != first.fingerprint()
    assert depth_of(second.depths(three_views(), BOUNDS)[0]) != before


def test_graphs_of_another_form_are_refused(tmp_path: Path) -> None:
    path = graphs.pick(tmp_path / "m.onnx", "K", (0, 0, 0))
    with pytest.raises(PluginError, match="no input 'imgs'"):
        mvs(path, family="mvsformer")
    with pytest.raises(PluginError, match="SHA-256"):
        mvs(path, sha256="0" * 64)
    four = graphs.mono(tmp_path / "mono.onnx", "images")
    with pytest.raises(PluginError, match="is not a set of images"):
        mvs(four)
    small = graphs.pick(tmp_path / "small.onnx", "K", (0, 0, 0), shrink=2)
    with pytest.raises(PluginError, match=r"\[1, 1, 16, 32\], expected \[1, 1, 32, 64\]"):
        asked(small)
