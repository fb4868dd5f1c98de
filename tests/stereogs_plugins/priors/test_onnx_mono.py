"""Monocular networks, with a graph that returns the red channel plus 10."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch import Tensor

from registry import PluginError
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


def test_a_graph_like_metric3d_with_depth_and_normals(tmp_path: Path) -> None:
    """`image` [1, 3, 616, 1064] in 0..255; `pred_depth` beside normals and their confidence."""
    graph = graphs.Graph()
    shape = (1, 3, 616, 1064)
    given = graph.input("image", shape)
    red = graph.slice(given, 1, 0, 1)
    graph.output("pred_depth", graph("Add", red, graph.constant(1.0)), (1, 1, *shape[2:]))
    graph.output("pred_normal", given, shape)
    graph.output("normal_confidence", red, (1, 1, *shape[2:]))
    path = graph.save(tmp_path / "m.onnx")
    wanted = {"family": "dpt", "value_range": "0..255", "output": "pred_depth", "answers": "depth"}
    found = [
        {key: value for key, value in settings.items() if key not in ("model", "sha256")}
        for settings in OnnxMono.settings_for(OnnxModel(path))
    ]
    assert wanted in found
    answer = mono(path, **wanted).inverse_depth(torch.full((30, 40, 3), 0.8))
    assert torch.allclose(answer, torch.tensor(1 / 205))


def test_resizing_is_bicubic(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Which overshoots beside an edge, though never beyond black and white."""
    given: list[Tensor] = []
    run = OnnxModel.run

    def watched(self: OnnxModel, inputs: dict[str, Tensor]) -> dict[str, Tensor]:
        given.extend(inputs.values())
        return run(self, inputs)

    monkeypatch.setattr(OnnxModel, "run", watched)
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
    """Depths of 0 and below become a thousandth of the median, and the largest inverse depth."""
    path = graphs.mono(tmp_path / "m.onnx", shape=(1, 3, 32, 32), offset=-0.25)
    image = torch.full((32, 32, 3), 0.75)
    image[:4], image[4:8] = 0.25, 0.0
    answer = mono(path, answers="depth", value_range="0..1").inverse_depth(image)
    assert torch.allclose(answer[8:], torch.tensor(2.0))
    assert torch.allclose(answer[:8], torch.tensor(2000.0))
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
