"""Every approximation and every skip of the engine, and the settings that `make bench-error` tries."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal

import torch

from core_rasterizer import Device, GaussianModel
from core_rasterizer.device import Variant
from core_rasterizer.raster import Renderer

Overrides = Mapping[str, float]
EXACT: Overrides = {"ALPHA_CUT_INVERSE": 1e6, "EARLY_STOP": 1e-12, "EXACT_TILE_TEST": 0}
"""With these and in double, nothing is left out that could be seen."""


@dataclass(frozen=True)
class Setting:
    """One position of a switch: how to build the kernels, and what to ask of them."""

    label: str
    overrides: Overrides = field(default_factory=dict)
    default: bool = False
    dtype: torch.dtype = torch.float32
    variant: Variant | None = None
    sh_degree: int = 3
    depth_gradient: bool = False
    """Hand the backward pass a gradient of the depth image, all zero: work that changes nothing."""


@dataclass(frozen=True)
class Switch:
    """Settings that differ in one respect.

    `baseline` is what their error is measured from: "double" for double-precision kernels with the
    overrides `exact` and all else at its default, so that the error is that of this switch alone;
    "default" for the engine as it is, where a switch should change nothing.
    """

    name: str
    settings: tuple[Setting, ...]
    baseline: Literal["double", "default"] = "double"
    exact: Overrides = field(default_factory=dict)


def switches(device: Device) -> list[Switch]:
    """Those that the device's raster kernels have."""
    on_cpu = device.variant == "cpu"
    result = [
        Switch("alpha cut-off", tuple(_alpha_cuts()), exact={"ALPHA_CUT_INVERSE": 1e6}),
        Switch("early stop", tuple(_early_stops()), exact={"EARLY_STOP": 1e-12}),
    ]
    if on_cpu:  # elsewhere exp2 is an instruction
        result.append(Switch("exponential", tuple(_exponentials())))
    result += [
        Switch(
            "number type",
            (Setting("double", dtype=torch.float64), Setting("float", default=True)),
        ),
        Switch("SH degree", tuple(_degrees())),
        Switch("tile size", tuple(_tile_sizes(device)), "default"),
        Switch(
            "exact tile test",
            (Setting("off", {"EXACT_TILE_TEST": 0}), Setting("on", default=True)),
            "default",
        ),
        Switch(
            "depth gradient",
            (Setting("computed", depth_gradient=True), Setting("skipped", default=True)),
            "default",
        ),
    ]
    if on_cpu:
        kernels = (Setting("GPU's", variant="gpu"), Setting("CPU's", default=True))
        result.append(Switch("raster kernels", kernels, "default"))
    return result


def build(model: GaussianModel, setting: Setting) -> GaussianModel:
    """The same Gaussians, to be rendered with another setting."""
    device = model.device.as_variant(setting.variant) if setting.variant else model.device
    result = GaussianModel(model.gaussians(), device, dtype=setting.dtype)
    result.renderer = Renderer(device, setting.dtype, overrides=setting.overrides)
    return result


def _alpha_cuts() -> Iterator[Setting]:
    yield Setting("1e-6", {"ALPHA_CUT_INVERSE": 1e6})
    yield Setting("1/255", default=True)
    yield Setting("2/255", {"ALPHA_CUT_INVERSE": 127.5})


def _early_stops() -> Iterator[Setting]:
    yield Setting("1e-12", {"EARLY_STOP": 1e-12})
    yield Setting("1e-4", default=True)
    yield Setting("1e-3", {"EARLY_STOP": 1e-3})


def _exponentials() -> Iterator[Setting]:
    yield Setting("built in", {"EXP2_DEGREE": 0})
    yield Setting("degree 5", default=True)
    yield Setting("degree 4", {"EXP2_DEGREE": 4})
    yield Setting("degree 3", {"EXP2_DEGREE": 3})


def _degrees() -> Iterator[Setting]:
    yield Setting("3", default=True)
    for degree in (2, 1, 0):
        yield Setting(str(degree), sh_degree=degree)


def _tile_sizes(device: Device) -> Iterator[Setting]:
    default = Renderer(device).programs.tile
    sizes = ((32, 16), (32, 32), (64, 32), (64, 64))
    for width, height in sizes if device.variant == "cpu" else ((8, 8), (16, 8), (16, 16)):
        overrides = {"TILE_WIDTH": width, "TILE_HEIGHT": height}
        yield Setting(f"{width}x{height}", overrides, default=(width, height) == default)
