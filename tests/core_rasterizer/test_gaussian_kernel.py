"""Kernels over Gaussians: the same numbers as torch, on every kind of device."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from core_rasterizer import Device, DeviceError, ExplainedError, GaussianKernel, GaussianModel
from tests.core_rasterizer.scenes import parameters, random_camera

KERNEL = GaussianKernel(
    """
    const lane opacity = 1 / (1 + lane_exp(-opacity_logits));
    #if HAS_held
    faded = held > 0 ? opacity : factor * opacity;
    #else
    faded = factor * opacity;
    #endif
    lean = means[0] - means[2] + 10 * pairs[1];
    slope = lane_abs(d_opacity_logits);
    size = lane_abs(d_sh[1]);
    """,
    parameters=["opacity_logits", "means"],
    gradients=["opacity_logits", "sh"],
    outputs=["faded", "lean"],
    sums=["slope", "size"],
)


def rendered(device: Device, count: int, dtype: torch.dtype = torch.float32) -> GaussianModel:
    model = GaussianModel(parameters(count), device, dtype=dtype)
    camera = random_camera(torch.Generator().manual_seed(1), 40, 28)
    model.zero_gradients()
    model.render(camera).rgb.square().sum().backward()
    return model


def results(model: GaussianModel, held: Tensor | None) -> list[Tensor]:
    pairs = torch.arange(2.0 * model.count).reshape(-1, 2)
    outputs, sums = KERNEL(model.reader(), held=held, pairs=pairs, factor=0.5)
    return [outputs["faded"].clone(), outputs["lean"].clone(), torch.tensor(list(sums.values()))]


def expected(model: GaussianModel, held: Tensor | None) -> list[Tensor]:
    opacities, means = model.opacities(), model.read("means")
    faded = torch.where(
        torch.zeros(model.count, dtype=torch.bool) if held is None else held, 1, 0.5
    )
    lean = means[:, 0] - means[:, 2] + 10 * (2 * torch.arange(model.count) + 1)
    slope = model.gradient("opacity_logits").abs().sum()
    sums = torch.stack([slope, model.gradient("sh")[:, 0, 1].abs().sum()])
    return [(faded * opacities).float(), lean.float(), sums.float()]


@pytest.mark.parametrize("shared", [True, False], ids=["shared", "discrete"])
@pytest.mark.parametrize("count", [37, 1030])
def test_it_computes_what_torch_does_and_repeats_its_bits(
    device: Device, shared: bool, count: int
) -> None:
    model = rendered(device if shared else device.as_discrete(), count)
    for held in (None, torch.arange(count) % 3 == 0):
        pairs = zip(results(model, held), results(model, held), expected(model, held), strict=True)
        for ours, again, theirs in pairs:
            assert torch.equal(ours, again)
            torch.testing.assert_close(ours, theirs, rtol=1e-5, atol=1e-6)


def test_gradients_of_losses_on_parameters_count(device: Device) -> None:
    model = rendered(device, 37)
    model.parameter("opacity_logits").square().sum().backward()
    for ours, theirs in zip(results(model, None), expected(model, None), strict=True):
        torch.testing.assert_close(ours, theirs, rtol=1e-5, atol=1e-6)


def test_a_model_in_double_precision_is_read_in_single(device: Device) -> None:
    model = rendered(device, 37, torch.float64)
    for ours, theirs in zip(results(model, None), expected(model, None), strict=True):
        torch.testing.assert_close(ours, theirs, rtol=1e-5, atol=1e-6)


def test_mistakes_are_explained(device: Device) -> None:
    reader = rendered(device, 5).reader()
    kernel = GaussianKernel("out = weights * 2;", outputs=["out"])
    with pytest.raises(ExplainedError, match="does not name the input 'wieghts'"):
        kernel(reader, wieghts=torch.ones(5))
    with pytest.raises(ExplainedError, match=r"'weights' is \(4,\); there are 5 Gaussians"):
        kernel(reader, weights=torch.ones(4))
    with pytest.raises(DeviceError, match=r"wobble(?s:.)*correct the source"):
        GaussianKernel("out = 1 +;", outputs=["out"], name="wobble")(reader)
