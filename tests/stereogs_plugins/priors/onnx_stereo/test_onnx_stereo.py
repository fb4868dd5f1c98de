"""Stereo networks, with tiny graphs of the families' names, types and sizes and known outputs."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from registry import PluginError
from registry.priors import Disparity
from registry.toolkit.networks import OnnxModel
from stereogs_plugins.priors.onnx_stereo import OnnxStereo, stereogs_register_priors
from tests.data import data_folder
from tests.host import load_pair
from tests.stereogs_plugins.building import build, offered
from tests.stereogs_plugins.priors import graphs

SHIFT = 5


def stereo(model: Path, **settings: object) -> OnnxStereo:
    return build(OnnxStereo, model=model, **settings)


def holds(answer: Disparity, shift: float, inside: slice, *, share: float = 1.0) -> bool:
    """Whether the disparity is the true one, in columns whose 5x5 surroundings both images show."""
    values = answer.values[4:-4, inside]
    return bool((values == shift).float().mean() >= share)


def finds_the_shift(prior: OnnxStereo, height: int, width: int, shift: int = SHIFT) -> bool:
    left, right = graphs.textured_pair(height, width, shift)
    of_left, of_right = prior.both(left, right)
    margin = shift + 4
    return holds(of_left, shift, slice(margin, -4)) and holds(of_right, shift, slice(4, -margin))


def test_registers_as_onnx_stereo() -> None:
    assert offered(stereogs_register_priors) == {"onnx_stereo": OnnxStereo}


def test_foundation_stereo_pads_504x378_to_its_frozen_512x384(tmp_path: Path) -> None:
    path = graphs.matcher(tmp_path / "m.onnx", shape=(1, 3, 384, 512))
    prior = stereo(path, family="foundation_stereo")
    assert prior.max_disparity == 416
    assert finds_the_shift(prior, 378, 504)


def test_c_fast_foundation_stereo_gets_multiples_of_32_in_imagenets_range(tmp_path: Path) -> None:
    names = ("left_image", "right_image", "disparity")
    family = "c_fast_foundation_stereo"
    path = graphs.matcher(tmp_path / "m.onnx", names, multiple=32)
    assert finds_the_shift(stereo(path, family=family), 60, 90)
    with pytest.raises(PluginError, match="the model failed"):
        finds_the_shift(stereo(path, family=family, multiple=1), 60, 90)
    red = stereo(graphs.echo(tmp_path / "red.onnx", names=names), family=family)
    image = torch.ones(64, 64, 3)
    assert torch.allclose(red.disparity(image, image).values, torch.tensor((1 - 0.485) / 0.229))


@pytest.mark.parametrize("output_kind", [graphs.FLOAT, graphs.HALF])
def test_float16_graphs(tmp_path: Path, output_kind: int) -> None:
    path = graphs.matcher(tmp_path / "m.onnx", kind=graphs.HALF, output_kind=output_kind)
    assert finds_the_shift(stereo(path), 60, 90)


def test_lite_any_stereo_at_its_frozen_size(tmp_path: Path) -> None:
    path = graphs.matcher(
        tmp_path / "m.onnx", ("left", "right", "disparity"), shape=(1, 3, 384, 1248), candidates=8
    )
    prior = stereo(path, family="lite_any_stereo")
    assert prior.max_disparity == 192
    assert finds_the_shift(prior, 375, 620)


def test_raft_stereo_flow_is_negated(tmp_path: Path) -> None:
    path = graphs.raft_stereo(tmp_path / "m.onnx")
    assert finds_the_shift(stereo(path, family="raft_stereo"), 60, 90)
    left, right = graphs.textured_pair(60, 90, SHIFT)
    unsigned = stereo(path, family="raft_stereo", negated=False)
    assert not unsigned.disparity(left, right).valid.any()


def test_a_generic_graph_by_order_and_by_name(tmp_path: Path) -> None:
    path = graphs.matcher(tmp_path / "m.onnx", ("left_image", "right_image", "any"), sign=-1.0)
    assert finds_the_shift(stereo(path, negated=True), 60, 90)
    swapped = stereo(path, negated=True, left="right_image", right="left_image")
    assert not finds_the_shift(swapped, 60, 90)


def test_a_mirrored_pair_gives_the_right_image_s_disparity_even_with_uneven_padding(
    tmp_path: Path,
) -> None:
    """57 columns are padded by 3 and 4 to 64; the mirror image must not be off by that one."""
    assert finds_the_shift(stereo(graphs.matcher(tmp_path / "m.onnx")), 41, 57)


@pytest.mark.parametrize(("height", "width"), [(378, 504), (5, 7), (32, 64), (33, 95)])
def test_a_constant_shift_survives_padding_everywhere(
    tmp_path: Path, height: int, width: int
) -> None:
    prior = stereo(graphs.constant_shift(tmp_path / "m.onnx", 7.25))
    image = torch.rand(height, width, 3)
    for answer in prior.both(image, image):
        assert answer.valid.all()
        assert (answer.values == 7.25).all()


def test_padding_repeats_the_border_and_is_cropped(tmp_path: Path) -> None:
    path = graphs.echo(tmp_path / "m.onnx")
    left, right = graphs.textured_pair(41, 57, 0)
    answer = stereo(path, value_range="0..1").disparity(left, right)
    assert torch.equal(answer.values, left[..., 0])


@pytest.mark.parametrize(
    ("value_range", "expected"),
    [("0..255", 255 * 0.8), ("0..1", 0.8), ("-1..1", 0.6), ("imagenet", (0.8 - 0.485) / 0.229)],
)
def test_images_have_the_value_range_of_the_graph(
    tmp_path: Path, value_range: str, expected: float
) -> None:
    image = torch.full((32, 32, 3), 0.8)
    path = graphs.echo(tmp_path / "m.onnx")
    answer = stereo(path, value_range=value_range).disparity(image, image)
    assert torch.allclose(answer.values, torch.tensor(expected))


def test_bytes_are_rounded(tmp_path: Path) -> None:
    image = torch.full((32, 32, 3), 100.4 / 255)
    path = graphs.echo(tmp_path / "m.onnx", kind=graphs.BYTE)
    assert (stereo(path).disparity(image, image).values == 100).all()


def test_s2m2_takes_bytes_and_its_confidences_mask(tmp_path: Path) -> None:
    path = graphs.s2m2(tmp_path / "m.onnx", 64, 96)
    left, right = graphs.textured_pair(60, 90, SHIFT)
    left[:20, :, 1] = 0.2  # confidence 0.2
    left[20:, :, 1] = 0.8
    left[40:50] = 0  # not visible
    answer = stereo(path, family="s2m2").disparity(left, right)
    assert not answer.valid[:20].any()
    assert not answer.valid[40:50].any()
    rest = torch.cat([answer.valid[20:40], answer.valid[50:]])
    assert rest.float().mean() > 0.5
    trusting = stereo(path, family="s2m2", min_confidence=0.1).disparity(left, right)
    assert trusting.valid[:20].float().mean() > 0.5
    assert not trusting.valid[40:50].any()
    blind = stereo(path, family="s2m2", confidences=()).disparity(left, right)
    assert blind.valid[40:50].any()


def test_s2m2_finds_the_shift(tmp_path: Path) -> None:
    path = graphs.s2m2(tmp_path / "m.onnx", 64, 96)
    assert finds_the_shift(stereo(path, family="s2m2", min_confidence=0.0), 60, 90)


def test_two_graphs_with_the_correlation_volume_between_them(tmp_path: Path) -> None:
    first, second = graphs.feature_pair(tmp_path, 64, 96)
    prior = stereo(first, family="fast_foundation_stereo", second_model=second)
    assert prior.max_disparity == 16  # the second graph's four candidates, four pixels each
    left, right = graphs.textured_pair(64, 96, 8)
    of_left, of_right = prior.both(left, right)
    assert (of_left.values[:, 8:] - 8).abs().max() < 0.01
    assert (of_right.values[:, :-8] - 8).abs().max() < 0.01


def test_two_graphs_must_match(tmp_path: Path) -> None:
    first, second = graphs.feature_pair(tmp_path, 64, 96)
    family = "fast_foundation_stereo"
    with pytest.raises(PluginError, match="two model files"):
        stereo(first, family=family)
    with pytest.raises(PluginError, match="one model file"):
        stereo(first, family="generic", second_model=second)
    other = graphs.matcher(tmp_path / "m.onnx")
    with pytest.raises(PluginError, match="no output 'features_left_04'"):
        stereo(other, family=family, second_model=second)
    with pytest.raises(PluginError, match=r"takes \['left', 'right'\]"):
        stereo(first, family=family, second_model=other)
    with pytest.raises(PluginError, match="SHA-256"):
        stereo(first, family=family, second_model=second, second_sha256="0" * 64)


def test_an_image_larger_than_the_frozen_size_is_shrunk_and_its_disparity_scaled(
    tmp_path: Path,
) -> None:
    prior = stereo(graphs.constant_shift(tmp_path / "m.onnx", 6.0, (1, 3, 64, 96)))
    image = torch.rand(100, 288, 3)  # shrunk to a third, 33 x 96, and padded
    answer = prior.disparity(image, image)
    assert answer.valid.all()
    assert torch.allclose(answer.values, torch.tensor(18.0))


def test_a_shrunk_pair_of_known_disparity(tmp_path: Path) -> None:
    path = graphs.matcher(tmp_path / "m.onnx", shape=(1, 3, 64, 96))
    left, right = graphs.textured_pair(60, 96, 3)
    large = [image.repeat_interleave(2, 0).repeat_interleave(2, 1) for image in (left, right)]
    answer = stereo(path).disparity(*large)
    assert holds(answer, 6, slice(14, -8), share=0.99)


def test_size_with_resize_stretches_images(tmp_path: Path) -> None:
    path = graphs.constant_shift(tmp_path / "m.onnx", 6.0)
    image = torch.rand(50, 64, 3)
    answer = stereo(path, size=(96, 64), resize=True).disparity(image, image)
    assert torch.allclose(answer.values, torch.tensor(6.0 * 64 / 96))
    rounded = stereo(path, resize=True, multiple=48).disparity(image, image)
    assert torch.allclose(rounded.values, torch.tensor(6.0 * 64 / 48))


def test_black_padding_is_seen_by_the_graph(tmp_path: Path, calls: list[dict[str, Tensor]]) -> None:
    path = graphs.constant_shift(tmp_path / "m.onnx", 1.0)
    image = torch.full((30, 31, 3), 0.5)
    for padding, border in (("replicate", 127.5), ("black", 0.0)):
        stereo(path, padding=padding).disparity(image, image)
        given = calls[-1]["left"]
        assert given.shape == (1, 3, 32, 32)
        assert (given[0, :, 0] == border).all()
        assert (given[0, :, 1:31, :31] == 127.5).all()


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Tensor]]:
    """Inputs of graphs, call by call."""
    seen: list[dict[str, Tensor]] = []
    run = OnnxModel.run

    def watched(self: OnnxModel, inputs: dict[str, Tensor]) -> Any:
        seen.append(inputs)
        return run(self, inputs)

    monkeypatch.setattr(OnnxModel, "run", watched)
    return seen


@pytest.mark.parametrize(("batch", "expected"), [("N", 1), (1, 2)])
def test_both_directions_share_one_call_if_the_batch_is_dynamic(
    tmp_path: Path, calls: list[dict[str, Tensor]], batch: int | str, expected: int
) -> None:
    prior = stereo(graphs.matcher(tmp_path / "m.onnx", shape=(batch, 3, "H", "W")))
    assert finds_the_shift(prior, 60, 90)
    assert len(calls) == expected
    left, right = graphs.textured_pair(60, 90, SHIFT)
    alone = prior.disparity(left, right)
    assert torch.equal(alone.values, prior.both(left, right)[0].values)


def test_unknown_disparities_stay_unknown(tmp_path: Path) -> None:
    """Zero and NaN are unknown; resizing does not smear them into their neighbours' values."""
    path = graphs.echo(tmp_path / "m.onnx", shape=(1, 3, 32, 64))
    image = torch.full((64, 128, 3), 0.5)
    image[:, 64:] = 0
    answer = stereo(path, value_range="0..1").disparity(image, image)
    assert answer.valid[:, :62].all()
    assert not answer.valid[:, 68:].any()
    assert torch.allclose(answer.values[:, :60], torch.tensor(1.0))  # 0.5 at half the width


def test_an_output_of_another_size_is_refused(tmp_path: Path) -> None:
    prior = stereo(graphs.quarter_size(tmp_path / "m.onnx"))
    image = torch.rand(32, 64, 3)
    with pytest.raises(PluginError, match=r"\[1, 1, 8, 16\], expected \[1, 1, 32, 64\]") as caught:
        prior.disparity(image, image)
    assert "output" in caught.value.fix


def test_two_real_photographs(tmp_path: Path) -> None:
    """Padded from 450x375; a mirrored or shifted answer would agree with the truth nowhere."""
    pair = load_pair(data_folder("stereo_cones"))
    path = graphs.matcher(tmp_path / "m.onnx", shape=(1, 3, 384, 512), candidates=60)
    of_left, of_right = stereo(path, family="foundation_stereo").both(pair.left, pair.right)
    near = (of_left.values - pair.disparity).abs() <= 1.5
    assert near[pair.known].float().mean() > 0.75
    columns = torch.arange(450)[None].expand(375, 450)
    other = of_right.values.gather(1, (columns - of_left.values.long()).clamp(min=0))
    agrees = (other - of_left.values).abs() <= 1.5
    assert agrees[pair.known].float().mean() > 0.8
    assert near[pair.known & agrees].float().mean() > 0.85


def test_files_and_names_are_checked_when_the_prior_is_built(tmp_path: Path) -> None:
    path = graphs.raft_stereo(tmp_path / "m.onnx")
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    assert isinstance(stereo(path, family="raft_stereo", sha256=digest), OnnxStereo)
    with pytest.raises(PluginError, match="SHA-256"):
        stereo(path, family="raft_stereo", sha256="0" * 64)
    with pytest.raises(PluginError, match="cannot be read"):
        stereo(tmp_path / "none.onnx")
    with pytest.raises(PluginError, match="no input 'left'") as caught:
        stereo(path, family="foundation_stereo")
    assert "image1 float32[?, 3, ?, ?]" in caught.value.fix
    with pytest.raises(PluginError, match="2 outputs; its name must be specified"):
        stereo(path)
    with pytest.raises(PluginError, match="no output 'trust'"):
        stereo(path, family="raft_stereo", confidences=("trust",))
    with pytest.raises(PluginError, match="a stereo pair needs two"):
        stereo(graphs.mono(tmp_path / "mono.onnx"))
    with pytest.raises(PluginError, match="is not an image"):
        stereo(graphs.pick(tmp_path / "mvs.onnx", "K", (0, 0, 0)))
    with pytest.raises(ValueError, match="sha256"):
        stereo(path, sha256="abc")
