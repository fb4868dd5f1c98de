"""State of the pixels between buckets of pairs, from which a GPU computes gradients: see `raster_gpu.cl`."""

from __future__ import annotations

import numpy as np
import torch

from ..device import Device, DeviceArray, Scratch
from .frame import Frame
from .programs import RasterPrograms

BUCKET = 32
"""Neighbouring pairs of a tile, BATCH of the kernels: one work-item each."""
NUMBERS = 2
"""Per pixel: the transmittance, and the contribution of what lies behind to the loss."""


class Checkpoints:
    """Runs the backward pass of the GPU's blending kernels.

    Args:
        device: where to run.
        dtype: of the kernels.
        programs: whose tiles are used.
    """

    def __init__(self, device: Device, dtype: torch.dtype, programs: RasterPrograms) -> None:
        self._dtype, self._programs = dtype, programs
        self._pixels = programs.tile[0] * programs.tile[1]
        self._scratch = Scratch(device)

    @property
    def bytes_of_bucket(self) -> int:
        """Memory for each `BUCKET` pairs, and for each tile."""
        return self._pixels * NUMBERS * self._dtype.itemsize + 4

    def backward(
        self,
        frame: Frame,
        image_gradients: list[DeviceArray],
        sums: DeviceArray,
        with_depth: bool,
        with_absolute: bool,
    ) -> None:
        """Write the sums of each (tile, Gaussian) pair."""
        arrays, tiles = frame.arrays, frame.tiles[0] * frame.tiles[1]
        places = frame.pairs // BUCKET + tiles
        checkpoints = self._scratch.reserve(
            "checkpoints", self._dtype, places * self._pixels * NUMBERS
        )
        opened = self._scratch.reserve("open", torch.int32, places)
        inputs = arrays.all("records", "pairs", "tile_starts", "camera")
        program = self._programs.raster(absolute=with_absolute)
        self._programs.run_on_tiles(
            program,
            "checkpoint",
            frame.tiles,
            *inputs,
            *arrays.all("rgb", "depth", "transmittance"),
            *image_gradients,
            *(checkpoints, opened),
            np.int32(frame.tiles[0]),
            np.int32(with_depth),
        )
        program.run(
            "raster_backward",
            (places * BUCKET,),
            (BUCKET,),
            *inputs,
            *image_gradients[:2],
            *(checkpoints, opened, sums),
            np.uint32(tiles),
            np.int32(frame.tiles[0]),
            np.int32(with_depth),
        )
