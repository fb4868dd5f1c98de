"""State of the pixels between buckets of pairs, from which a GPU computes gradients: see `raster_gpu.cl`."""

from __future__ import annotations

import torch

from ..device import Device, DeviceArray, Scratch
from .frame import Frame
from .programs import RasterPrograms

NUMBERS = 2
"""Per pixel: the transmittance, and the contribution of what lies behind to the loss."""


class PixelStates:
    """Runs the backward pass of the GPU's blending kernels.

    Args:
        device: where to run.
        dtype: of the kernels.
        programs: whose tiles are used.
    """

    # A bucket is a number of neighbouring pairs of a tile, with one work-item each.

    def __init__(self, device: Device, dtype: torch.dtype, programs: RasterPrograms) -> None:
        self._dtype, self._programs = dtype, programs
        self._pixels = programs.tile[0] * programs.tile[1]
        self._bucket = device.profile.bucket
        self._scratch = Scratch(device)

    @property
    def bytes_of_tile(self) -> int:
        """Memory for each tile."""
        return self._pixels * NUMBERS * self._dtype.itemsize + 4

    @property
    def bytes_of_pair(self) -> int:
        """Memory for each pair: its share of a bucket's, which is as large as a tile's."""
        return self.bytes_of_tile // self._bucket

    def backward(
        self,
        frame: Frame,
        image_gradients: dict[str, DeviceArray],
        sums: DeviceArray,
        with_depth: bool,
        with_absolute: bool,
    ) -> None:
        """Write the sums of each (tile, Gaussian) pair."""
        arrays, tiles = frame.arrays, frame.tiles[0] * frame.tiles[1]
        places = frame.pairs // self._bucket + tiles
        reserve = self._scratch.reserve
        shared: dict[str, DeviceArray | float] = {
            **arrays.named("records", "pairs", "tile_starts", "camera"),
            "pixel_states": reserve("states", self._dtype, places * self._pixels * NUMBERS),
            "unfinished": reserve("unfinished", torch.int32, places),
            "tiles_x": frame.tiles[0],
            "with_depth": with_depth,
        }
        colors = {name: image_gradients[name] for name in ("d_rgb", "d_depth")}
        program = self._programs.raster(absolute=with_absolute)
        self._programs.run_on_tiles(
            program,
            "save_pixel_states",
            frame.tiles,
            **shared,
            **arrays.named("rgb", "depth"),
            final_transmittance=arrays["transmittance"],
            **image_gradients,
        )
        program.run(
            "raster_backward",
            (places * self._bucket,),
            (self._bucket,),
            **shared,
            **colors,
            pair_sums=sums,
            tiles=tiles,
        )
