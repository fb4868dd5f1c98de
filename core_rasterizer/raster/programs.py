"""The rendering kernels of one device: which sources and macros each job needs, and how it is launched."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch

from ..device import Device, Program
from ..errors import ExplainedError
from .footprint import Footprint
from .request import RenderRequest
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
"""Macro of kernels that also sum what pixels pull at means, without signs."""

OVERRIDES = frozenset(
    (
        "ALPHA_CUT_INVERSE",
        "EARLY_STOP",
        "EXACT_TILE_TEST",
        "EXP2_DEGREE",
        "RASTER_LANES",
        "TILE_HEIGHT",
        "TILE_WIDTH",
    )
)
"""Macros of the kernels that a `Renderer` may be built with instead of their defaults."""


class RasterPrograms:
    """Kernels that project Gaussians and blend them, built when they are asked for first.

    Args:
        device: where to run; `device.variant` decides which raster kernels and tile size.
        dtype: torch.float32, or torch.float64 where the device supports it.
        lists: whose kernels are built together with those that project.
        footprint: what is added to a Gaussian's ellipse on the image.
        overrides: values of macros in `OVERRIDES`, instead of their defaults.

    Attributes:
        tile: width and height of a tile, pixels.
        base: kernels that project for a render with no `RenderRequest.features`, and those of `lists`.

    Raises:
        ExplainedError: an override that no kernel knows.
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
                f"no kernel has the setting {', '.join(unknown)}",
                where="Renderer: overrides",
                fix=f"use {', '.join(sorted(OVERRIDES))}",
            )
        self._device = device
        self._dtype = dtype
        self._on_cpu = device.variant == "cpu"
        # A CPU with few cores wants large tiles (less overlap), one with many wants enough of them.
        few_cores = self._on_cpu and device.compute_units <= 4
        width, height = ((64, 32) if few_cores else (32, 32)) if self._on_cpu else (16, 16)
        # No number of lanes: as many as the processor has registers for.
        macros = {"TILE_WIDTH": width, "TILE_HEIGHT": height, "RASTER_LANES": 0, **overrides}
        self.tile = (int(macros["TILE_WIDTH"]), int(macros["TILE_HEIGHT"]))
        self._group = 16 if self._on_cpu else 64
        self._projection_macros = {**macros, **footprint.macros, "PROJECT_GROUP": self._group}
        self.base = device.program(
            *_PROJECTION,
            _BACKWARD,
            *lists.sources,
            dtype=dtype,
            **self._projection_macros,
            **lists.macros,
        )
        lanes = macros["RASTER_LANES"] if self._on_cpu else 1
        self._raster_macros: dict[str, Any] = {**macros, "LANES": lanes}
        self.raster()  # the first render need not wait for the compiler

    def projection(self, request: RenderRequest) -> Program:
        """The kernels that project, for what a render asks for."""
        if not request.features:
            return self.base
        return self._device.program(
            *_PROJECTION,
            *(("raster/pose",) if request.wants_pose_gradient else ()),
            _BACKWARD,
            dtype=self._dtype,
            **self._projection_macros,
            **dict.fromkeys(request.features, 1),
        )

    def raster(self, *, absolute: bool = False) -> Program:
        """The kernels that blend.

        Args:
            absolute: the backward pass also collects absolute screen gradients.
        """
        return self._device.program(
            "raster/scene",
            "raster/blend",
            "raster/raster_cpu" if self._on_cpu else "raster/raster_gpu",
            dtype=self._dtype,
            **self._raster_macros,
            **({_ABSOLUTE: 1} if absolute else {}),
        )

    def run_on_blocks(self, program: Program, kernel: str, capacity: int, *arguments: Any) -> None:
        """Run a kernel that takes `capacity` Gaussians, a device's lanes in each work-item."""
        blocks = capacity // self._device.lanes
        size = -(-blocks // self._group) * self._group
        program.run(kernel, (size,), (self._group,), *arguments)

    def run_on_tiles(
        self, program: Program, kernel: str, tiles: tuple[int, int], *arguments: Any
    ) -> None:
        """Run a kernel over so many tiles across and down: a work-item each on a CPU, else one a pixel."""
        local = 1 if self._on_cpu else self.tile[0] * self.tile[1]
        program.run(kernel, (tiles[0] * tiles[1] * local,), (local,), *arguments)
