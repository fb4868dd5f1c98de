"""Graphs that take both images as one tensor, the form of the HITNet files in circulation."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from registry import PluginError
from registry.toolkit.networks import OnnxModel
from tests.stereogs_plugins.priors import graphs
from tests.stereogs_plugins.priors.onnx_stereo.test_onnx_stereo import finds_the_shift, stereo

COLOUR = (0.9, 0.4, 0.2)
GREY = 0.299 * 0.9 + 0.587 * 0.4 + 0.114 * 0.2


@pytest.mark.parametrize("channels", [2, 6])
@pytest.mark.parametrize("channels_last", [False, True])
def test_the_shift_is_found_in_both_layouts(
    tmp_path: Path, channels: int, channels_last: bool
) -> None:
    path = graphs.stacked_matcher(tmp_path / "m.onnx", channels, channels_last=channels_last)
    assert finds_the_shift(stereo(path, family="hitnet"), 60, 90)


@pytest.mark.parametrize(
    ("channels", "expected"), [(2, (GREY, 0.5 * GREY)), (6, (*COLOUR, *(c / 2 for c in COLOUR)))]
)
def test_left_channels_come_first_in_grey_and_in_colour(
    tmp_path: Path, channels: int, expected: tuple[float, ...]
) -> None:
    left = torch.tensor(COLOUR).expand(32, 32, 3)
    for channel, value in enumerate(expected):
        path = graphs.stacked_echo(tmp_path / f"{channel}.onnx", channels, channel)
        answer = stereo(path, family="hitnet").disparity(left, 0.5 * left)
        assert torch.allclose(answer.values, torch.tensor(value))


@pytest.mark.parametrize(("batch", "calls"), [(1, 2), ("N", 1)])
def test_both_directions_share_one_call_if_the_batch_is_dynamic(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, batch: int | str, calls: int
) -> None:
    path = graphs.stacked_matcher(tmp_path / "m.onnx", 6, channels_last=True, batch=batch)
    prior = stereo(path, family="generic", stacked=True)
    batches: list[int] = []
    run = OnnxModel.run

    def watched(self: OnnxModel, inputs: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
        batches.append(len(inputs["input"]))
        return run(self, inputs)

    monkeypatch.setattr(OnnxModel, "run", watched)
    assert finds_the_shift(prior, 60, 90)
    assert (len(batches), sum(batches)) == (calls, 2)


def test_a_graph_without_a_stacked_pair_is_an_error(tmp_path: Path) -> None:
    mono = graphs.mono(tmp_path / "mono.onnx")
    with pytest.raises(PluginError, match="is not a stacked pair"):
        stereo(mono, family="hitnet")
    apart = graphs.matcher(tmp_path / "apart.onnx")
    with pytest.raises(PluginError, match="2 inputs"):
        stereo(apart, family="hitnet")
    stacked = graphs.stacked_matcher(tmp_path / "m.onnx", 2, channels_last=False)
    with pytest.raises(PluginError, match="needs two") as caught:
        stereo(stacked)
    assert "stacked" in caught.value.fix
