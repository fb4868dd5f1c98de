"""`stereogs priors check` recognizes files of every format and finds the right settings."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from registry import PluginError, PointCloud, Scene, TrainingView
from registry.priors import DepthMap, Matches
from registry.toolkit.networks import OnnxModel
from stereogs.verbs.priors import prior_trials
from stereogs.verbs.priors.prior_trials import score as prior_score, truth_of
from stereogs_plugins.scenes.procedural import ProceduralScene
from tests.host import SELECTION, Plugins, main, parse_pipeline
from tests.stereogs_plugins.building import build
from tests.stereogs_plugins.priors import graphs, known_answers as known, modules, rooms

Capture = pytest.CaptureFixture[str]


@pytest.fixture(autouse=True)
def _all_installed_plugins(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(SELECTION)


@pytest.fixture(scope="module")
def plugins() -> Plugins:
    return Plugins()


@pytest.fixture(scope="module")
def small_row() -> Scene:
    """A small version of the trial scene; disparities are at most 13 pixels."""
    return build(
        ProceduralScene, row_spacing=0.25, test_views=0, width=128, height=96, points=0
    ).load()


@pytest.fixture
def _small(small_row: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    truth = truth_of(small_row.train, small_row.bounds)
    monkeypatch.setattr(prior_trials, "known_truth", lambda plugins, device: truth)


def guessed(path: Path, plugins: Plugins) -> list[tuple[str, dict[str, object]]]:
    """Names and settings, without paths and hashes."""
    found = prior_trials.guesses(OnnxModel(path), plugins)
    names = ("model", "sha256", "features")
    return [
        (g.offer.name, {key: value for key, value in g.settings.items() if key not in names})
        for g in found
    ]


def test_families_are_recognized_by_their_names(tmp_path: Path, plugins: Plugins) -> None:
    foundation = graphs.matcher(tmp_path / "f.onnx", shape=(1, 3, 64, 96))
    assert guessed(foundation, plugins) == [("onnx_stereo", {"family": "foundation_stereo"})]
    names = ("left_image", "right_image", "disparity")
    assert guessed(graphs.matcher(tmp_path / "c.onnx", names), plugins) == [
        ("onnx_stereo", {"family": "c_fast_foundation_stereo"})
    ]
    names = ("left", "right", "disparity")
    lite = graphs.matcher(tmp_path / "l.onnx", names, shape=(1, 3, 384, 1248), candidates=2)
    assert guessed(lite, plugins) == [("onnx_stereo", {"family": "lite_any_stereo"})]
    other = guessed(graphs.matcher(tmp_path / "o.onnx", names), plugins)
    assert [settings["family"] for _, settings in other] == ["generic"] * 8
    assert guessed(graphs.s2m2(tmp_path / "s.onnx", 64, 96), plugins) == [
        ("onnx_stereo", {"family": "s2m2"})
    ]
    stacked = graphs.stacked_matcher(tmp_path / "h.onnx", 2, channels_last=True)
    assert {settings["family"] for _, settings in guessed(stacked, plugins)} == {"hitnet"}
    posed = graphs.pick(tmp_path / "p.onnx", "K", (0, 0, 0))
    assert guessed(posed, plugins) == [
        ("onnx_mvs", {"family": "mvsanywhere", "intrinsics": grid}) for grid in ("full", "quarter")
    ]
    staged = graphs.pick_staged(tmp_path / "g.onnx", "stage1", (0, 0, 0, 0))
    assert guessed(staged, plugins)[0] == (
        "onnx_mvs",
        {"family": "mvsformer", "intrinsics": "full"},
    )


def test_other_formats_are_recognized(tmp_path: Path, plugins: Plugins) -> None:
    forms = {
        "onnx_mono": graphs.mono(tmp_path / "mono.onnx"),
        "onnx_flow": graphs.constant_flow(tmp_path / "flow.onnx", (1.0, 0.0)),
        "onnx_matching": graphs.brightest_pixels(tmp_path / "points.onnx", 24, 40),
    }
    for name, path in forms.items():
        assert {found for found, _ in guessed(path, plugins)} == {name}
    features = graphs.grey_features(tmp_path / "features.onnx")
    assert guessed(features, plugins) == [
        (name, {"cost": "features"}) for name in ("plane_sweep", "sgm")
    ]
    with pytest.raises(PluginError, match="no installed prior supports a file with these inputs"):
        guessed(graphs.matcher_of_points(tmp_path / "matcher.onnx"), plugins)


@pytest.mark.usefixtures("_small")
def test_trials_find_the_sign_and_print_valid_yaml(
    tmp_path: Path, capsys: Capture, plugins: Plugins
) -> None:
    path = graphs.matcher(tmp_path / "m.onnx", ("a", "b", "c"), candidates=16, sign=-1.0)
    assert main(["priors", "check", str(path), "--set", "value_range=0..255"]) == 0
    said = capsys.readouterr().out
    assert "a float32[?, 3, ?, ?]" in said
    assert OnnxModel(path).sha256 in said
    assert "value_range=0..255: error 1.000" in said  # not negated: nowhere above 0
    (wrong,) = re.findall(r"best: (.*)% of the pixels that both images show are off", said)
    assert float(wrong) < 15
    written = said[said.index("priors:") :]
    text = f"name: n\nscene: procedural\ninitializer: sfm\n{written}"
    (item,) = parse_pipeline(text, plugins).items["priors"]
    chosen = item.settings.model_dump()
    assert (chosen["model"], chosen["negated"]) == (path, True)
    assert chosen["value_range"] == "0..255"


@pytest.mark.usefixtures("_small")
def test_a_file_that_no_settings_can_run_is_an_error(tmp_path: Path, capsys: Capture) -> None:
    path = graphs.brightest_pixels(tmp_path / "points.onnx", 24, 40)
    assert main(["priors", "check", str(path)]) == 1
    said = capsys.readouterr().out
    assert "needs the setting 'matcher'" in said
    assert "no settings worked" in said
    assert main(["priors", "check", str(tmp_path / "none.onnx")]) == 2


@pytest.mark.usefixtures("_small")
@pytest.mark.parametrize(
    ("counted", "seen", "arguments", "fault"),
    [
        (None, 100, [], ""),
        (1, 100, [], "a copy of the second view as third changes the depth by"),
        (None, 1, [], "the depth does not depend on the third view"),
        (1, 100, ["--set", "max_sources=1"], ""),
        (None, 1, ["--set", "max_sources=1"], ""),
    ],
)
def test_a_constant_number_of_views_is_refused(
    tmp_path: Path,
    capsys: Capture,
    counted: int | None,
    seen: int,
    arguments: list[str],
    fault: str,
) -> None:
    path = graphs.mean_of_sources(tmp_path / "m.onnx", counted, seen=seen)
    options = ["--set", "value_range=0..255", *arguments]
    assert main(["priors", "check", str(path), *options]) == (1 if fault else 0)
    said = capsys.readouterr().out
    assert fault in said
    assert ("max_sources: 1" in said) == (bool(fault) or "max_sources=1" in arguments)
    assert ("priors:" in said) is not bool(fault)


@pytest.mark.usefixtures("_small")
@pytest.mark.parametrize(
    ("network", "count", "pinned", "fault"),
    [
        ("vggt", "N", 0, ""),
        ("depth_anything_3", "N", 0, ""),
        ("depth_anything_3", 4, 0, ""),
        ("depth_anything_3", "N", 2, "a copy of the second view as third changes the depth by"),
        ("depth_anything_3", "N", 3, "a copy of the second view as third changes the depth by"),
    ],
)
def test_cameras_and_depth_are_measured_together(
    tmp_path: Path, capsys: Capture, network: str, count: int | str, pinned: int, fault: str
) -> None:
    views = rooms.room(56, 42, row_spacing=0.25)
    views = (*views, views[-1])
    poses = torch.stack([view.camera.world_to_camera[:3] for view in views])
    poses[:, :, 3] *= 5  # the unit of a network
    views = tuple(replace(view, depth=5 * depth_of(view)) for view in views)
    path = tmp_path / "m.onnx"
    if network == "vggt":
        codes = torch.stack([rooms.pose_code(view.camera) for view in views])
        codes[:, :3] *= 5
        rooms.vggt(path, views, codes)
    else:
        rooms.depth_anything_3(path, views, poses, count=count, pinned=pinned)
    assert main(["priors", "check", str(path)]) == (1 if fault else 0)
    said = capsys.readouterr().out
    assert fault in said
    assert ("use: onnx_posed" in said) is not bool(fault)
    (wrong,) = re.findall(r"onnx_posed: error (\d\.\d+)", said)
    assert (float(wrong) < 0.1) == (pinned in (0, 3))


@pytest.mark.usefixtures("_small")
@pytest.mark.filterwarnings("ignore:.torch.jit:DeprecationWarning")
def test_a_torchscript_file_is_tried(tmp_path: Path, capsys: Capture) -> None:
    path = modules.saved(tmp_path / "m.pt", modules.Mean())
    assert main(["priors", "check", str(path)]) == 0
    said = capsys.readouterr().out
    assert said.count("torch_module value_range=") == 4
    assert "use: torch_module" in said
    other = modules.saved(tmp_path / "other.ts", modules.Other())
    assert main(["priors", "check", str(other)]) == 2
    assert "no installed prior supports" in capsys.readouterr().err


def test_gaussians_are_measured_by_the_surface_of_the_first_view(small_row: Scene) -> None:
    truth = truth_of(small_row.train, small_row.bounds)
    camera = small_row.train[0].camera
    u, v = (x.ravel()[::7] for x in camera.pixel_centers())
    points = camera.unproject(u, v, depth_of(small_row.train[0]).double().ravel()[::7])
    faint = torch.where(torch.arange(len(points)) % 2 == 0, 0.9, 0.1)
    for scale, error in ((1.0, 0.0), (1.1, 1.0)):
        moved = camera.center + scale * (points - camera.center)
        cloud = PointCloud(moved.float(), torch.ones(len(points), 3), opacities=faint)
        found = prior_score(known.gaussians(cloud), truth)
        assert found.error == pytest.approx(error, abs=1e-3)
        assert f"in {(1 - error) / 14:.1%} of all" in found.text


@pytest.mark.usefixtures("_small")
def test_a_graph_for_two_views_gets_two(tmp_path: Path) -> None:
    assert (
        main(["priors", "check", str(graphs.pick(tmp_path / "p.onnx", "K", (0, 0, 0), views=2))])
        == 0
    )


def test_ground_truth_matches_the_other_view(small_row: Scene) -> None:
    first, second = small_row.train[:2]
    truth = truth_of(small_row.train, small_row.bounds)
    assert first.depth is not None
    disparity = first.camera.fx * 0.25 / first.depth
    assert torch.allclose(-truth.moved[..., 0], disparity.double(), atol=1e-5)
    assert truth.moved[..., 1].abs().max() < 1e-9
    assert 0.6 < truth.visible.float().mean() < 0.98
    column = (torch.arange(128)[None] + 0.5 + truth.moved[..., 0]).clamp(0, 127).long()
    shown = second.image[torch.arange(96)[:, None], column]
    difference = (shown - first.image).abs().mean(dim=2)
    assert difference[truth.visible].mean() < 0.6 * difference[~truth.visible].mean()


def depth_of(view: TrainingView) -> torch.Tensor:
    assert view.depth is not None
    return view.depth


def test_predictions_are_scored_against_the_ground_truth(small_row: Scene) -> None:
    truth = truth_of(small_row.train, small_row.bounds)
    disparity, visible = -truth.moved[..., 0], truth.visible
    assert prior_score(known.stereo(disparity.float()), truth).error == 0
    assert prior_score(known.stereo((disparity + 1.9).float()), truth).error == 0
    assert prior_score(known.stereo((disparity + 2.1).float()), truth).error == 1
    half = disparity.float().where(torch.arange(128)[None] % 2 == 0, 0.0)
    assert prior_score(known.stereo(half), truth).error == pytest.approx(0.5, abs=0.02)
    assert prior_score(known.flow(truth.moved.float()), truth).error == 0
    assert prior_score(known.flow(-truth.moved.float()), truth).error == 1
    depth = depth_of(small_row.train[0])
    maps = [DepthMap(depth * f, depth > 0, torch.ones_like(depth)) for f in (1.02, 1.04)]
    assert [prior_score(known.depth(one), truth).error for one in maps] == [0, 1]
    assert prior_score(known.nearness(5 / depth + 3), truth).error == pytest.approx(0, abs=1e-3)
    assert prior_score(known.nearness(-1 / depth), truth).error == pytest.approx(2, abs=1e-3)
    assert prior_score(known.nearness(0 * depth), truth).error == 1
    v, u = visible.nonzero()[::50].unbind(dim=1)
    here = torch.stack([u, v], dim=1) + 0.5
    there = here + truth.moved[v, u]
    there[: len(there) // 4] += 3
    result = prior_score(known.matches(Matches(here, there, torch.ones(len(here)))), truth)
    assert result.error == pytest.approx(0.25, abs=0.01)
