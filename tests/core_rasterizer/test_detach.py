"""Renders that detach parameters."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from core_rasterizer import Device, GaussianError, GaussianModel
from core_rasterizer.layout import PARAMETERS
from tests.core_rasterizer.scenes import gradients_of, parameters, view


def lossy(model: GaussianModel, seed: int, *detach: str) -> Tensor:
    rendering = model.render(view(seed), detach=detach, collect_statistics=True)
    return rendering.rgb.square().sum() + rendering.depth.sum() + rendering.alpha.sum()


@pytest.mark.parametrize("detached", [*((name,) for name in PARAMETERS), PARAMETERS, ()], ids=str)
def test_detach_zeroes_only_the_detached_gradients(
    device: Device, detached: tuple[str, ...]
) -> None:
    model = GaussianModel(parameters(), device)
    lossy(model, 0).backward()
    whole, statistics = gradients_of(model), model.statistics.sums()
    model.zero_gradients()
    model.statistics.reset()
    lossy(model, 0, *detached).backward()
    for name, gradient in gradients_of(model).items():
        assert torch.equal(gradient, 0 * gradient if name in detached else whole[name]), name
    assert torch.equal(model.statistics.sums(), statistics)


@pytest.mark.parametrize("detached_first", [False, True])
def test_other_renders_of_the_iteration_still_contribute(
    device: Device, detached_first: bool
) -> None:
    model = GaussianModel(parameters(), device)
    alone = []
    for seed in (1, 2):
        model.zero_gradients()
        lossy(model, seed).backward()
        alone.append(gradients_of(model))
    model.zero_gradients()
    losses = [lossy(model, 1), lossy(model, 2, "means", "sh")]
    for loss in reversed(losses) if detached_first else losses:
        loss.backward()
    for name, gradient in gradients_of(model).items():
        if name in ("means", "sh"):
            assert torch.equal(gradient, alone[0][name]), name
        else:
            total = alone[0][name] + alone[1][name]
            assert torch.allclose(
                gradient, total, rtol=1e-4, atol=float(1e-4 * total.abs().max())
            ), name


def test_an_unknown_name_raises(device: Device) -> None:
    model = GaussianModel(parameters(5), device)
    with pytest.raises(GaussianError, match="unknown parameter 'scales'"):
        model.render(view(), detach={"scales"})
