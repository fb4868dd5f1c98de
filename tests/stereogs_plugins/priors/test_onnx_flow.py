"""Flow networks, with a graph whose flow depends on which image is brighter, so it passes the cycle check."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch import Tensor

from registry import PluginError
from registry.testing import check
from registry.toolkit.networks import OnnxModel
from stereogs_plugins.priors.onnx_flow import OnnxFlow, stereogs_register_priors
from tests.stereogs_plugins.building import build, offered
from tests.stereogs_plugins.priors import graphs

BRIGHT, DARK = 0.75, 0.25
"""Half a unit apart: the graphs' flow is halved."""


def flow(model: Path, **settings: object) -> OnnxFlow:
    return build(OnnxFlow, model=model, value_range="0..1", **settings)


def flat(brightness: float, height: int = 30, width: int = 45) -> Tensor:
    return torch.full((height, width, 3), brightness)


def test_is_registered_and_keeps_the_contract(tmp_path: Path) -> None:
    assert offered(stereogs_register_priors) == {"onnx_flow": OnnxFlow}
    check(OnnxFlow, model=graphs.flow_of_brightness(tmp_path / "m.onnx", (4.0, 2.0)))


def test_the_flow_has_the_sign_and_order_of_the_graph(tmp_path: Path) -> None:
    """Padded from 45x30 to 48x32; what leaves the image is not known to come back."""
    prior = flow(graphs.flow_of_brightness(tmp_path / "m.onnx", (8.0, -4.0)))
    answer = prior.flow(flat(BRIGHT), flat(DARK))
    assert torch.allclose(answer.vectors[2:, :-4], torch.tensor([4.0, -2.0]))
    assert answer.valid[2:, :-4].all()
    assert not answer.valid[:2].any()
    assert not answer.valid[:, -4:].any()
    back = prior.flow(flat(DARK), flat(BRIGHT))
    assert torch.allclose(back.vectors[:-2, 4:], torch.tensor([-4.0, 2.0]))


def test_a_vector_that_fails_the_cycle_check_is_unknown(tmp_path: Path) -> None:
    """Two images as bright as each other: the graph that adds a shift adds it both ways."""
    path = graphs.flow_of_brightness(tmp_path / "m.onnx", (8.0, 0.0))
    prior = flow(path, max_cycle_error=0.5)
    ramp = flat(BRIGHT)
    assert prior.flow(ramp, ramp).valid.all()
    one_way = graphs.constant_flow(tmp_path / "c.onnx", (1.0, 0.0))
    assert not flow(one_way, max_cycle_error=1.9).flow(ramp, ramp).valid.any()
    assert flow(one_way, max_cycle_error=2.1).flow(ramp, ramp).valid[:, :-1].all()
    kept = flow(one_way, max_cycle_error=None).flow(ramp, ramp)
    assert kept.valid.all()
    assert torch.allclose(kept.vectors, torch.tensor([1.0, 0.0]))


def test_a_frozen_size_shrinks_the_images_and_stretches_the_flow(tmp_path: Path) -> None:
    path = graphs.constant_flow(tmp_path / "m.onnx", (1.0, 2.0), (1, 3, 32, 48))
    answer = flow(path, max_cycle_error=None).flow(flat(BRIGHT, 60, 96), flat(DARK, 60, 96))
    assert torch.allclose(answer.vectors, torch.tensor([2.0, 4.0]))


def test_images_of_two_sizes(tmp_path: Path) -> None:
    """No flow in the common size: a pixel goes to the same share of the other image."""
    path = graphs.constant_flow(tmp_path / "m.onnx", (0.0, 0.0))
    answer = flow(path).flow(flat(BRIGHT), flat(DARK, 60, 135))
    assert torch.allclose(answer.vectors[0, 0], torch.tensor([0.5 * 3 - 0.5, 0.5 * 2 - 0.5]))
    assert torch.allclose(answer.vectors[-1, -1], torch.tensor([44.5 * 2, 29.5]))


def test_images_follow_the_value_range_and_the_input_names(tmp_path: Path) -> None:
    path = graphs.flow_of_brightness(tmp_path / "m.onnx", (1 / 255, 0.0))
    bytes_ = build(OnnxFlow, model=path, max_cycle_error=None)
    assert torch.allclose(
        bytes_.flow(flat(1.0), flat(0.5)).vectors, torch.tensor([0.5, 0.0]), atol=1e-6
    )
    swapped = build(OnnxFlow, model=path, first="image2", second="image1", max_cycle_error=None)
    assert torch.allclose(
        swapped.flow(flat(1.0), flat(0.5)).vectors, torch.tensor([-0.5, 0.0]), atol=1e-6
    )


def test_graphs_of_another_form_are_refused(tmp_path: Path) -> None:
    with pytest.raises(PluginError, match="has 1 inputs, optical flow needs two"):
        flow(graphs.mono(tmp_path / "mono.onnx"))
    path = graphs.flow_of_brightness(tmp_path / "three.onnx", (1.0, 1.0), channels=3)
    with pytest.raises(PluginError, match=r"\[1, 3, 32, 48\], expected \[1, 2, 32, 48\]"):
        flow(path).flow(flat(BRIGHT), flat(DARK))
    assert not OnnxFlow.settings_for(OnnxModel(path))
    good = graphs.flow_of_brightness(tmp_path / "two.onnx", (1.0, 1.0))
    assert OnnxFlow.settings_for(OnnxModel(good))
    with pytest.raises(PluginError, match="no output 'flow'"):
        flow(path, output="flow")
