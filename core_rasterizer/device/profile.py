"""How the kernels divide their work on a device: every constant that is tuned for speed."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Literal

Variant = Literal["cpu", "gpu"]

FEW = 1 << 13
_MAX_CHUNKS = 64


@dataclass(frozen=True)
class DeviceProfile:
    """Sizes of groups, tiles and shares; `for_device` chooses them.

    Distances of prefetching and other constants that depend on the code around them stay in the kernels.

    Args:
        lanes: reals per vector: neighbouring elements that a work-item owns.
        wide_lanes: the same for rasterizer, SSIM and the ZNCC sweep; 0: the kernels choose by the processor's
            registers (`kernels/lanes.cl`).
        tile: width and height of a tile of the image, pixels.
        bucket: neighbouring pairs of a tile whose backward pass is one work-group; on a GPU.
        project_group: work-items per group that project Gaussians.
        project_span: Gaussians that each of these takes, one vector after another.
        adam_group: work-items per group of a step from stored gradients.
        adam_span: adjacent columns that each of these takes.
        topology_group: work-items per group that move Gaussians.
        digit_bits: bits that one pass of the sort looks at.
        scan_group: work-items per group of a prefix sum over chunks; on a CPU.
        chunks: of Gaussians that are sorted and binned in parallel; on a CPU.
        few: up to this many Gaussians are sorted and binned by one work-item, in one launch; on a CPU.
        list_group: work-items per chunk; on a GPU.
        list_chunk: elements per chunk; on a GPU.
        max_list_chunks: more elements make larger chunks instead, so that tables of counts stay small.
        ssim_tile: width and height of the pixels of a work-group of the loss; on a GPU.
        min_ssim_band: rows of a band of the loss below which each core takes one band, not two; on a CPU. A
            band computes ten extra rows; two per core balance a late start.
        path_lines: adjacent lines per work-item of semi-global aggregation.
        sweep_tile: width and height of the pixels of a work-item of the ZNCC sweep.
        sweep_group: work-items per group of the ZNCC sweep, one per plane.
        sweep_planes: planes of a work-item of both sweeps.
        window_rows: rows per work-item of rectified ZNCC, which first sums the rows of one window.
    """

    lanes: int
    wide_lanes: int
    tile: tuple[int, int]
    project_group: int
    project_span: int
    adam_group: int
    adam_span: int
    chunks: int
    few: int
    path_lines: int
    sweep_tile: tuple[int, int]
    sweep_group: int
    sweep_planes: int
    bucket: int = 32
    topology_group: int = 64
    digit_bits: int = 11
    scan_group: int = 16
    list_group: int = 256
    list_chunk: int = 2048
    max_list_chunks: int = 4096
    ssim_tile: int = 16
    min_ssim_band: int = 20
    window_rows: int = 64

    @classmethod
    def for_device(cls, variant: Variant, compute_units: int) -> DeviceProfile:
        """The constants for a variant of the kernels and a number of cores."""
        return _for_gpu() if variant == "gpu" else _for_cpu(compute_units)

    def list_chunks(self, elements: int) -> int:
        """Number of chunks, on a GPU, of an array that may have this many elements."""
        return min(self.max_list_chunks, max(1, -(-elements // self.list_chunk)))

    def ssim_band(self, height: int, cores: int) -> int:
        """Image rows per band of the loss on a CPU."""
        half = -(-height // (2 * cores))
        return half if half >= self.min_ssim_band or cores == 1 else -(-height // cores)


def _for_gpu() -> DeviceProfile:
    return DeviceProfile(
        lanes=1,
        wide_lanes=1,
        tile=(16, 16),
        project_group=64,
        project_span=1,
        adam_group=64,
        adam_span=1,
        chunks=1,
        few=0,
        path_lines=1,
        sweep_tile=(16, 16),
        sweep_group=16,
        sweep_planes=1,
    )


def _for_cpu(cores: int) -> DeviceProfile:
    return DeviceProfile(
        lanes=8,  # eight floats fill an AVX register
        wide_lanes=0,
        tile=_cpu_tile(cores),
        # PoCL gives each work-item of a group a copy of private arrays, and a group of 16 would exceed the
        # first level of caches.
        project_group=1,
        project_span=128,
        adam_group=1,
        adam_span=4096,
        # Two per core, so that one that starts late is not waited for long.
        chunks=min(_MAX_CHUNKS, 2 * cores),
        # On two cores the thirteen launches that are saved take as long as half of the work on 16,384
        # Gaussians; on c cores the others would save the share 1 - 1/c.
        few=FEW * cores // (cores - 1) if cores > 1 else sys.maxsize,
        # Neighbouring pixels share cache lines.
        path_lines=8,
        sweep_tile=(64, 64),
        sweep_group=1,
        sweep_planes=16,
    )


def _cpu_tile(cores: int) -> tuple[int, int]:
    """A work-item renders a tile.

    With few cores tiles are large, for less overlap (smaller ones cost 2 to 8 % more); with many they are
    small, so that 504x378 pixels are six tiles for each of 64.
    """
    if cores <= 4:
        return 64, 32
    return (32, 32) if cores <= 16 else (32, 16)
