from __future__ import annotations

import pytest
import torch

from registry.testing import check
from stereogs_plugins.regularizers.parameter_l1 import ParameterL1
from tests.stereogs_plugins.building import build, moment_with, some_gaussians


@pytest.mark.parametrize("parameter", ["opacities", "scales"])
def test_it_keeps_the_contract(parameter: str) -> None:
    check(ParameterL1, parameter=parameter)


@pytest.mark.parametrize(
    ("parameter", "stored", "mean"),
    [("opacities", "opacity_logits", 0.5), ("scales", "log_scales", 0.06)],
)
def test_is_a_mean_and_its_gradient_reaches_what_is_stored(
    parameter: str, stored: str, mean: float
) -> None:
    step, model = moment_with(some_gaussians([0.02, 0.1], [0.2, 0.8]))
    model.zero_gradients()
    loss = build(ParameterL1, parameter=parameter).loss(step)
    assert float(loss.detach()) == pytest.approx(mean)
    loss.backward()
    values = model.read(stored).double().requires_grad_()
    activated = values.sigmoid() if parameter == "opacities" else values.exp()
    activated.mean().backward()
    assert values.grad is not None
    torch.testing.assert_close(model.gradient(stored).double(), values.grad)
