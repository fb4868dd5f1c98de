"""Monocular networks, with a graph that returns the red channel plus 10."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch import Tensor

from core_rasterizer import Camera
from registry import PluginError, TrainingView
from registry.toolkit.networks import OnnxModel
from stereogs_plugins.priors.onnx_mono import OnnxMono, stereogs_register_priors
from tests.stereogs_plugins.building import build, offered
from tests.stereogs_plugins.priors import graphs


def mono(model: Path, **settings: object) -> OnnxMono:
    return build(OnnxMono, model=model, **settings)


@pytest.fixture
def sizes(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, ...]]:
    """Shapes of the graphs' inputs."""
    seen: list[tuple[int, ...]] = []
    run = OnnxModel.run

    def watched(self: OnnxModel, inputs: dict[str, Tensor]) -> dict[str, Tensor]:
        seen.extend(tuple(value.shape) for value in inputs.values())
        return run(self, inputs)

    monkeypatch.setattr(OnnxModel, "run", watched)
    return seen


def test_registers_as_onnx_mono() -> None:
    assert offered(stereogs_register_priors) == {"onnx_mono": OnnxMono}


def test_a_missing_file_is_refused_with_the_address_of_the_network(tmp_path: Path) -> None:
    with pytest.raises(PluginError, match=r"DPT \(https://github.com/isl-org/DPT\)"):
        mono(tmp_path / "absent.onnx", family="dpt")


@pytest.mark.parametrize(
    ("family", "size", "given"),
    [
        ("dpt", (378, 504), (384, 512)),
        ("dpt", (504, 378), (512, 384)),
        ("depth_anything_v2", (378, 504), (518, 686)),  # 690.7 is nearest to 49 * 14
        ("depth_anything_v2", (100, 100), (518, 518)),
    ],
)
def test_the_short_side_is_that_of_the_family(
    tmp_path: Path,
    sizes: list[tuple[int, ...]],
    family: str,
    size: tuple[int, int],
    given: tuple[int, int],
) -> None:
    prior = mono(graphs.mono(tmp_path / "m.onnx"), family=family)
    assert prior.inverse_depth(torch.rand(*size, 3)).shape == size
    assert sizes == [(1, 3, *given)]


@pytest.mark.parametrize(
    ("family", "expected"), [("dpt", 0.6), ("depth_anything_v2", (0.8 - 0.485) / 0.229)]
)
def test_the_image_has_the_value_range_of_the_family(
    tmp_path: Path, family: str, expected: float
) -> None:
    prior = mono(graphs.mono(tmp_path / "m.onnx"), family=family)
    answer = prior.inverse_depth(torch.full((30, 40, 3), 0.8))
    assert torch.allclose(answer, torch.tensor(10 + expected), atol=1e-4)


def metric3d(path: Path) -> Path:
    """`image` `[1, 3, 616, 1064]` in 0..255: depth is red + 1; beside it normals and their confidence."""
    graph = graphs.Graph()
    shape = (1, 3, 616, 1064)
    given = graph.input("image", shape)
    red = graph.slice(given, 1, 0, 1)
    graph.output("pred_depth", graph("Add", red, graph.constant(1.0)), (1, 1, *shape[2:]))
    graph.output("pred_normal", given, shape)
    graph.output("normal_confidence", red, (1, 1, *shape[2:]))
    return graph.save(path)


def recognized(path: Path) -> list[dict[str, object]]:
    """The settings that are suggested for a file, without its name."""
    return [
        {key: value for key, value in settings.items() if key not in ("model", "sha256")}
        for settings in OnnxMono.settings_for(OnnxModel(path))
    ]


def of_camera(image: Tensor, fx: float, fy: float) -> TrainingView:
    height, width = image.shape[:2]
    return TrainingView(
        "one", Camera(torch.eye(4), fx, fy, width / 2, height / 2, width, height), image
    )


def test_depth_of_metric3d_is_metric_with_the_focal_length(tmp_path: Path) -> None:
    """Canonical depth is that of a focal length of 1000 pixels in the network's image."""
    path = metric3d(tmp_path / "m.onnx")
    assert recognized(path) == [{"family": "metric3d_v2"}]
    prior, image = mono(path, family="metric3d_v2"), torch.full((154, 154, 3), 0.8)
    found = prior.depth(image)
    assert (found.inverse, found.ambiguity, found.valid) == (False, "scale", None)
    assert torch.allclose(found.values, torch.tensor(205.0))
    seen = prior.depth_of(of_camera(image, 90.0, 110.0))  # enlarged 4 times, to 616 rows
    assert seen.ambiguity == "metric"
    assert torch.allclose(seen.values, torch.tensor(205.0 * 4 * 100 / 1000))
    own = prior.depth_of(of_camera(image, 45.0, 55.0))
    assert torch.allclose(own.values, torch.tensor(205.0 * 4 * 50 / 1000))


def inputs_of_graphs(monkeypatch: pytest.MonkeyPatch) -> list[Tensor]:
    """A list that grows by each input of a graph."""
    given: list[Tensor] = []
    run = OnnxModel.run

    def watched(self: OnnxModel, inputs: dict[str, Tensor]) -> dict[str, Tensor]:
        given.extend(inputs.values())
        return run(self, inputs)

    monkeypatch.setattr(OnnxModel, "run", watched)
    return given


def test_an_image_of_other_proportions_has_a_border_of_the_mean_colour(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = inputs_of_graphs(monkeypatch)
    rows = torch.linspace(0.2, 0.8, 154)[:, None, None].expand(154, 154, 3)
    found = mono(metric3d(tmp_path / "m.onnx"), family="metric3d_v2").depth(rows)
    assert torch.allclose(given[0][0, :, 0, 0], torch.tensor([123.675, 116.28, 103.53]), atol=1e-3)
    assert torch.allclose(
        given[0][0, :, 300, 223], torch.tensor([123.675, 116.28, 103.53]), atol=1e-3
    )
    assert (given[0][0, 0, :, 224:840].std(dim=1) < 1e-3).all()
    assert (found.values - 255 * rows[..., 0] - 1).abs().max() < 1


def test_points_of_unidepth_have_intrinsics_and_metres(tmp_path: Path) -> None:
    graph, shape = graphs.Graph(), ("batch", 3, 462, 630)
    given = graph.input("rgbs", shape)
    scaled = graph("Mul", given, graph.constant([[[[1.0]], [[1.0]], [[0.229]]]]))
    graph.output("pts_3d", graph("Add", scaled, graph.constant(2.0)), shape)
    graph.output("confidence", graph.slice(given, 1, 0, 1), ("batch", 1, *shape[2:]))
    lens = [[500.0, 0, 315], [0, 500, 231], [0, 0, 1]]
    graph.output("intrinsics", graph.constant([lens]), (1, 3, 3))
    path = graph.save(tmp_path / "m.onnx")
    assert recognized(path) == [{"family": "unidepth_v2"}]
    image = torch.full((231, 231, 3), 0.8)
    found = mono(path, family="unidepth_v2").depth(image)
    assert (found.inverse, found.ambiguity) == (False, "metric")
    assert torch.allclose(found.values, torch.tensor(2 + 0.229 * (0.8 - 0.406) / 0.225), atol=1e-4)
    assert found.intrinsics is not None
    assert found.intrinsics.flatten().tolist() == [250, 0, 115.5, 0, 250, 115.5, 0, 0, 1]


def test_the_export_script_of_unidepth_has_other_names(tmp_path: Path) -> None:
    graph, shape = graphs.Graph(), (1, 3, 28, 42)
    red = graph.slice(graph.input("image", shape), 1, 0, 1)
    graph.output("out_K", graph.constant([torch.eye(3).tolist()]), (1, 3, 3))
    for name in ("depth", "depth_ssi", "confidence"):
        graph.output(name, graph("Exp", red) if name == "depth" else red, (1, 1, 28, 42))
    path = graph.save(tmp_path / "m.onnx")
    assert recognized(path) == [{"family": "unidepth_v2"}]
    found = mono(path, family="unidepth_v2").depth(torch.full((28, 42, 3), 0.485))
    assert torch.allclose(found.values, torch.tensor(1.0), atol=1e-4)
    assert found.ambiguity == "metric"


@pytest.mark.parametrize("views", [(), (1,), ("V",)])
def test_depth_anything_3_with_one_view(tmp_path: Path, views: tuple[int | str, ...]) -> None:
    """Its sky is invalid; a graph of several views has cameras, and is for `onnx_posed` too."""
    graph, shape = graphs.Graph(), (1, *views, 3, "H", "W")
    image = graph.input("image", shape)
    red = graph.slice(image, len(views) + 1, 0, 1)
    graph.output("depth", graph("Exp", red), (1, *views, 1, "H", "W"))
    dark = graph("Cast", graph("Less", red, graph.constant(0.0)), to=graphs.FLOAT)
    if views == ("V",):
        graph.output(
            "extrinsics", graph.constant(torch.eye(4)[None, None].tolist()), (1, "V", 4, 4)
        )
    else:
        graph.output("sky", dark, (1, *views, 1, "H", "W"))
    path = graph.save(tmp_path / "m.onnx")
    assert recognized(path) == [{"family": "depth_anything_3"}] * (views != ("V",))
    picture = torch.full((378, 504, 3), 0.485)
    picture[:100] = 0.2
    prior = mono(path, family="depth_anything_3")
    found = prior.depth(picture)
    assert (found.inverse, found.ambiguity) == (False, "scale")
    assert torch.allclose(found.values[100:], torch.tensor(1.0), atol=1e-4)
    if views != ("V",):
        assert found.valid is not None
        assert found.valid.sum() == 278 * 504
    metric = mono(path, family="depth_anything_3", canonical_focal=300.0)
    seen = metric.depth_of(of_camera(picture, 600.0, 600.0))
    assert seen.ambiguity == "metric"
    assert torch.allclose(seen.values[100:], torch.tensor(2.0), atol=1e-4)


def test_resizing_is_bicubic(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Which overshoots beside an edge, though never beyond black and white."""
    given = inputs_of_graphs(monkeypatch)
    prior = mono(graphs.mono(tmp_path / "m.onnx"), family="dpt")
    for dark, bright in ((0.3, 0.7), (0.0, 1.0)):
        image = torch.full((30, 40, 3), dark)
        image[:, 20:] = bright
        prior.inverse_depth(image)
    assert given[0].max() > 0.4 + 0.01
    assert given[0].min() < -0.4 - 0.01
    assert given[1].max() == 1
    assert given[1].min() == -1


@pytest.mark.parametrize("shrink", [1, 2])
def test_the_result_is_aligned_with_the_image(tmp_path: Path, shrink: int) -> None:
    """Also if the output has half the size of the input."""
    prior = mono(graphs.mono(tmp_path / "m.onnx", shrink=shrink), family="dpt")
    rows, columns = torch.meshgrid(
        torch.linspace(0.1, 0.4, 90), torch.linspace(0.1, 0.5, 120), indexing="ij"
    )
    image = (rows + columns)[..., None].expand(90, 120, 3)
    answer = prior.inverse_depth(image)
    inside = (slice(3, -3), slice(3, -3))
    assert (answer - (10 + 2 * image[..., 0] - 1))[inside].abs().max() < 2e-3


def test_images_are_resized_to_a_fixed_size(tmp_path: Path, sizes: list[tuple[int, ...]]) -> None:
    path = graphs.mono(tmp_path / "m.onnx", shape=(1, 3, 28, 42))
    answer = mono(path).inverse_depth(torch.full((100, 90, 3), 0.485))
    assert sizes == [(1, 3, 28, 42)]
    assert torch.allclose(answer, torch.tensor(10.0), atol=1e-4)


def test_settings_override_short_side_multiple_and_value_range(
    tmp_path: Path, sizes: list[tuple[int, ...]]
) -> None:
    path = graphs.mono(tmp_path / "m.onnx")
    prior = mono(path, short_side=80, multiple=16, value_range="0..255")
    answer = prior.inverse_depth(torch.full((50, 70, 3), 0.8))
    assert sizes == [(1, 3, 80, 112)]
    assert torch.allclose(answer, torch.tensor(10 + 204.0))


def test_a_graph_can_return_depth(tmp_path: Path) -> None:
    """Depths below a thousandth of the median are invalid, and have the smallest inverse depth."""
    path = graphs.mono(tmp_path / "m.onnx", shape=(1, 3, 32, 32), offset=-0.25)
    image = torch.full((32, 32, 3), 0.75)
    image[:4], image[4:8], image[8:12] = 0.2501, 0.0, 0.5
    found = mono(path, answers="depth", value_range="0..1").depth(image)
    assert found.ambiguity == "scale"
    assert torch.allclose(found.nearness[12:], torch.tensor(2.0))
    assert torch.allclose(found.nearness[8:12], torch.tensor(4.0))
    assert torch.allclose(found.nearness[:8], torch.tensor(2.0))
    assert found.valid is not None
    assert found.valid[8:].all()
    assert not found.valid[:8].any()
    with pytest.raises(PluginError, match="returned no depth above 0"):
        mono(path, answers="depth", value_range="0..1").inverse_depth(0 * image)


def test_inputs_and_outputs_can_be_named(tmp_path: Path) -> None:
    path = graphs.mono(tmp_path / "m.onnx", "l_x_")
    image = torch.rand(30, 40, 3)
    expected = mono(path).inverse_depth(image)
    assert torch.equal(mono(path, input="l_x_", output="depth").inverse_depth(image), expected)
    with pytest.raises(PluginError, match="no input 'image'") as caught:
        mono(path, input="image")
    assert "l_x_ float32[1, 3, ?, ?]" in caught.value.fix
    with pytest.raises(PluginError, match="no output 'disp'"):
        mono(path, output="disp")
    with pytest.raises(PluginError, match="2 inputs; its name must be specified"):
        mono(graphs.matcher(tmp_path / "stereo.onnx"))


def test_graphs_of_another_form_are_refused(tmp_path: Path) -> None:
    sets = graphs.pick(tmp_path / "mvs.onnx", "K", (0, 0, 0))
    with pytest.raises(PluginError, match="is not an image"):
        mono(sets, input="images", output="depth")
    with pytest.raises(PluginError, match="SHA-256"):
        mono(graphs.mono(tmp_path / "m.onnx"), sha256="0" * 64)
    features = graphs.color_features(tmp_path / "f.onnx")
    with pytest.raises(PluginError, match=r"expected \[1, H, W\]"):
        mono(features).inverse_depth(torch.rand(30, 40, 3))


def test_the_model_is_part_of_the_cache_key(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STEREOGS_CACHE", str(tmp_path / "cache"))
    path = graphs.mono(tmp_path / "m.onnx", "first")
    image = torch.full((30, 40, 3), 0.5)
    first = mono(path)
    before = first.inverse_depth(image)
    graphs.mono(path, "first", offset=20.0)
    second = mono(path)  # the same settings, another file
    assert second.fingerprint() != first.fingerprint()
    assert torch.allclose(second.inverse_depth(image), before + 10)
