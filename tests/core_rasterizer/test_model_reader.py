"""The read-only view of a model."""

from __future__ import annotations

import torch

from core_rasterizer import Device, GaussianModel, GaussianReader
from core_rasterizer.layout import PARAMETERS
from tests.core_rasterizer.scenes import parameters, view

READABLE = {
    "absolute_screen_gradient",
    "compensate_dilation",
    "count",
    "device",
    "digest",
    "dilation",
    "gaussians",
    "gradient",
    "opacities",
    "parameter",
    "read",
    "render",
    "scales",
    "screen_gradient",
    "sh_degree",
    "touched",
}
STATISTICS = ("screen_gradient", "absolute_screen_gradient")


def test_its_public_names() -> None:
    assert {name for name in dir(GaussianReader) if not name.startswith("_")} == READABLE


def test_it_follows_the_model(device: Device) -> None:
    model = GaussianModel(parameters(30, sh_degree=2), device)
    reader = model.reader()
    assert isinstance(reader, GaussianReader)
    for count in (30, 16):
        rendering = model.render(view(), collect_statistics=True, collect_absolute=True)
        rendering.rgb.sum().backward()
        assert (reader.count, reader.sh_degree, reader.device) == (count, 2, device)
        for name in PARAMETERS:
            assert torch.equal(reader.read(name), model.read(name)), name
            assert torch.equal(reader.gradient(name), model.gradient(name)), name
            assert torch.equal(getattr(reader.gaussians(), name), model.read(name)), name
        for name in (*STATISTICS, "opacities", "scales", "touched", "digest"):
            source = model.statistics if name in STATISTICS else model
            ours, theirs = getattr(reader, name)(), getattr(source, name)()
            assert ours == theirs if name == "digest" else torch.equal(ours, theirs), name
        model.adopt(model.parameters.read()[:, :16].clone(), 16)


def test_it_says_how_renders_are_filtered(device: Device) -> None:
    for dilation, compensate in ((0.3, False), (0.125, True)):
        gaussians = parameters(3)
        model = GaussianModel(gaussians, device, dilation=dilation, compensate_dilation=compensate)
        reader = model.reader()
        assert (reader.dilation, reader.compensate_dilation) == (dilation, compensate)


def test_it_returns_copies(device: Device) -> None:
    model = GaussianModel(parameters(30), device)
    model.render(view()).rgb.sum().backward()
    reader = model.reader()
    digest, gradient = model.digest(), model.gradient("means").clone()
    for name in PARAMETERS:
        reader.read(name).fill_(7)
        reader.gradient(name).fill_(7)
    reader.gaussians().means.fill_(7)
    assert model.digest() == digest
    assert torch.equal(model.gradient("means"), gradient)


def test_losses_on_its_parameters_reach_the_model(device: Device) -> None:
    model = GaussianModel(parameters(30), device)
    model.reader().parameter("means").sum().backward()
    assert torch.equal(model.gradient("means"), torch.ones(30, 3))
