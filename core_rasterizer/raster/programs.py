"""The rendering kernels of one device: their sources, macros and launches."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

import torch

from ..device import Device, Program
from ..errors import ExplainedError
from .request import POSED, Footprint, RenderRequest
from .tile_lists import TileLists

_PROJECTION = (
    "raster/scene",
    "raster/harmonics",
    "raster/projection",
    "raster/cover",
    "raster/project",
)
_BACKWARD = "raster/project_backward"
_ABSOLUTE = "ABSOLUTE"
"""Macro of kernels that also sum the absolute screen gradients."""

OVERRIDES = frozenset(
    (
        "ALPHA_CUT_INVERSE",
        "EARLY_STOP",
        "EXACT_TILE_TEST",
        "EXP2_DEGREE",
        "RASTER_LANES",
        "SLANTED",
        "TILE_HEIGHT",
        "TILE_WIDTH",
    )
)
"""Kernel macros that a `Renderer` may override."""
_BLENDING_ONLY = ("EARLY_STOP", "EXP2_DEGREE", "RASTER_LANES", "SLANTED")
_PROJECTION_ONLY = ("EXACT_TILE_TEST",)
"""Macros that the other kernels do not use: programs that differ in them only are built once."""


class RasterPrograms:
    """Kernels that project and blend Gaussians, built on first use.

    Args:
        device: where to run; `device.variant` selects raster kernels and tile size.
        dtype: torch.float32, or torch.float64 where the device supports it.
        lists: whose kernels are built together with the projection.
        footprint: the filter on the image.
        overrides: values of macros in `OVERRIDES`.

    Attributes:
        tile: width and height of a tile, pixels.
        base: projection kernels for a render without `RenderRequest.features`, and those of `lists`.

    Raises:
        ExplainedError: an unknown override.
    """

    def __init__(
        self,
        device: Device,
        dtype: torch.dtype,
        lists: TileLists,
        footprint: Footprint,
        overrides: Mapping[str, float],
    ) -> None:
        if unknown := sorted(set(overrides) - OVERRIDES):
            raise ExplainedError(
                f"unknown kernel settings: {', '.join(unknown)}",
                where="Renderer: overrides",
                fix=f"use {', '.join(sorted(OVERRIDES))}",
            )
        self._device = device
        self._dtype = dtype
        self._on_cpu = device.variant == "cpu"
        profile = device.profile
        macros: dict[str, float] = {
            "TILE_WIDTH": profile.tile[0],
            "TILE_HEIGHT": profile.tile[1],
            "RASTER_LANES": profile.wide_lanes,
            **overrides,
        }
        self.tile = (int(macros["TILE_WIDTH"]), int(macros["TILE_HEIGHT"]))
        self._group, self._span = profile.project_group, profile.project_span
        self._projection_macros = {
            **_without(macros, _BLENDING_ONLY),
            **footprint.macros,
            "PROJECT_GROUP": self._group,
            "PROJECT_SPAN": self._span,
        }
        self.base = device.program(
            *_PROJECTION,
            _BACKWARD,
            *lists.sources,
            dtype=dtype,
            **self._projection_macros,
            **lists.macros,
        )
        lanes = macros["RASTER_LANES"] if self._on_cpu else 1
        unused: tuple[str, ...] = (*_PROJECTION_ONLY, "RASTER_LANES")
        if lanes == 1 or dtype == torch.float64:
            unused += ("EXP2_DEGREE",)  # these kernels use the compiler's exponential
        self._raster_macros: dict[str, Any] = {**_without(macros, unused), "LANES": lanes}
        # A look-up by the sources and macros would take longer than a launch.
        self._projection, self._step = cache(self._build_projection), cache(self._build_step)
        self._raster = cache(self._build_raster)
        self.raster()  # build now, so that the first render does not wait

    def projection(self, request: RenderRequest) -> Program:
        """The projection kernels for the options of a render."""
        features = request.features
        return self._projection(features) if features else self.base

    def step(self, request: RenderRequest) -> Program:
        """The kernel that ends a backward pass with a step of Adam, for the options of a render."""
        return self._step(request.features)

    def _build_projection(self, features: frozenset[str]) -> Program:
        return self._device.program(
            *_PROJECTION,
            *(("raster/pose",) if POSED in features else ()),
            _BACKWARD,
            dtype=self._dtype,
            **self._projection_macros,
            **dict.fromkeys(features, 1),
        )

    def _build_step(self, features: frozenset[str]) -> Program:
        return self._device.program(
            *_PROJECTION[:-2],
            _BACKWARD,
            "optimization/adam_values",
            "raster/backward_step",
            dtype=self._dtype,
            STEP=1,
            **self._projection_macros,
            **dict.fromkeys(features, 1),
        )

    def raster(self, *, absolute: bool = False) -> Program:
        """The blending kernels.

        Args:
            absolute: If True, the backward pass also collects absolute screen gradients.
        """
        return self._raster(absolute)

    def _build_raster(self, absolute: bool) -> Program:
        return self._device.program(
            "raster/scene",
            "raster/blend",
            "raster/raster_cpu" if self._on_cpu else "raster/raster_gpu",
            dtype=self._dtype,
            **self._raster_macros,
            **({} if self._on_cpu else {"BUCKET": self._device.profile.bucket}),
            **({_ABSOLUTE: 1} if absolute else {}),
        )

    def run_on_blocks(
        self, program: Program, kernel: str, capacity: int, /, **arguments: Any
    ) -> None:
        """Run a projection kernel over `capacity` Gaussians."""
        items = -(-capacity // self._span)
        size = -(-items // self._group) * self._group
        program.run(kernel, (size,), (self._group,), **arguments)

    def run_on_tiles(
        self, program: Program, kernel: str, tiles: tuple[int, int], /, **arguments: Any
    ) -> None:
        """Run a kernel over tiles (across, down): one work-item per tile on a CPU, else per pixel."""
        local = 1 if self._on_cpu else self.tile[0] * self.tile[1]
        program.run(kernel, (tiles[0] * tiles[1] * local,), (local,), **arguments)


def _without(macros: Mapping[str, float], names: tuple[str, ...]) -> dict[str, float]:
    return {name: value for name, value in macros.items() if name not in names}
