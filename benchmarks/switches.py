"""Approximations and skips of the engine, with the settings that `make bench-error` measures."""

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
"""With these and in double, no omission is visible."""


@dataclass(frozen=True)
class Setting:
    """One setting of a switch: options of the kernels and of the render."""

    label: str
    overrides: Overrides = field(default_factory=dict)
    default: bool = False
    dtype: torch.dtype = torch.float32
    variant: Variant | None = None
    sh_degree: int = 3
    depth_gradient: bool = False
    """Pass a zero gradient of the depth image to the backward pass: work without effect."""


@dataclass(frozen=True)
class Switch:
    """Settings that differ in one respect.

    Errors are relative to `baseline`: "double" for double-precision kernels with the overrides `exact` and
    all else at its default, which isolates the error of this switch; "default" for the default engine, if
    the switch should not change results.
    """

    name: str
    settings: tuple[Setting, ...]
    baseline: Literal["double", "default"] = "double"
    exact: Overrides = field(default_factory=dict)


def switches(device: Device) -> list[Switch]:
    """Return the switches of the device's raster kernels."""
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
    """Return the same Gaussians with another setting of the renderer."""
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
