"""Lists of the Gaussians that can touch each tile of an image, nearest first."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from ..device import Device, DeviceArray, Program, Scratch
from .frame import Frame

_ON_CPU = ("raster/scan", "raster/sort", "raster/bin", "raster/lists_of_few")
_ON_GPU = ("raster/scan", "raster/sort_gpu", "raster/bin_gpu")
_GPU_CHUNK_GROUP = 64
"""Work-items per chunk on a GPU; each counts the elements of all items before it."""

_DIGIT_BITS = 11
BUCKETS = 1 << _DIGIT_BITS
"""Row length of the sort's table of counts, which has one row per chunk."""
FEW = 1 << 14
"""Up to this many Gaussians are sorted and binned by one work-item of a CPU, in one launch instead of
fourteen. From twice as many on, two cores in parallel are faster despite the launches."""


def chunks_of(device: Device) -> int:
    """Number of chunks of Gaussians that are sorted and binned in parallel.

    On a CPU one per work-item, on a GPU one per work-group: enough to use every compute unit, few enough
    that summing over chunks is cheap. The number for a GPU is an estimate, not a measurement.
    """
    if device.variant == "cpu":
        return min(16, 2 * device.compute_units)
    return min(256, 2 * device.compute_units)


class TileLists:
    """Sorts the visible Gaussians by depth, and bins them by tile in that order.

    Args:
        device: where to run.

    Attributes:
        sources: the kernels' files; they need "raster/scene" and "raster/cover".
        macros: of the kernels.
    """

    def __init__(self, device: Device) -> None:
        self._device = device
        self._chunks = chunks_of(device)
        on_cpu = device.variant == "cpu"
        self._few = FEW if on_cpu else -1  # also for no Gaussians
        self._chunk_group = 1 if on_cpu else _GPU_CHUNK_GROUP
        self.sources = _ON_CPU if on_cpu else _ON_GPU
        self._group, self._items = (16, 1) if on_cpu else (64, 256)
        self.macros = {
            "DIGIT_BITS": _DIGIT_BITS,
            "SCAN_GROUP": self._group,
            "SCAN_ITEMS": self._items,
            "CHUNK_GROUP": self._chunk_group,
        }
        self._scratch = Scratch(device)

    def reserve(self, capacity: int, tiles: int) -> None:
        """Allocate scratch memory for a render's Gaussians and tiles."""
        sizes = {
            **dict.fromkeys(("keys", "keys_a", "order_a", "keys_b", "order_b"), capacity),
            "covers": 4 * capacity,
            "counts": self._chunks * max(BUCKETS, tiles),
            "totals": BUCKETS + 1,
            "chunk_pairs": self._chunks + 1,
        }
        for name, elements in sizes.items():
            self._scratch.reserve(name, torch.int32, elements)

    @property
    def keys(self) -> DeviceArray:
        """Sort keys, written by the projection: `[capacity]`, 32 bits."""
        return self._scratch["keys"]

    @property
    def covers(self) -> DeviceArray:
        """Tiles that each Gaussian can touch, written by the projection: `[4 * capacity]`, 32 bits."""
        return self._scratch["covers"]

    def build(self, program: Program, frame: Frame, count: int, pair_capacity: int) -> None:
        """Fill `frame.arrays["pairs"]`, unless it is too small for all pairs.

        Writes the numbers of visible Gaussians and of pairs to `frame.arrays["counters"]`.
        """
        if count <= self._few:
            self._build_alone(program, frame, count, pair_capacity)
        else:
            self._sort(program, frame, count)
            self._bin(program, frame, pair_capacity)

    def _build_alone(self, program: Program, frame: Frame, count: int, pair_capacity: int) -> None:
        arrays, scratch = frame.arrays, self._scratch
        program.run(
            "lists_of_few",
            (1,),
            (1,),
            arrays["records"],
            *scratch.all("covers", "keys", "keys_a", "order_a", "keys_b", "order_b", "counts"),
            *arrays.all("tile_starts", "pairs", "slot_start", "slot_count", "counters"),
            np.uint32(count),
            np.uint32(frame.tiles[0] * frame.tiles[1]),
            np.int32(frame.tiles[0]),
            np.uint32(frame.pair_limit),
            np.uint32(pair_capacity),
        )

    def _sort(self, program: Program, frame: Frame, count: int) -> None:
        """Write the visible Gaussians, nearest first, to the scratch array `order_a`."""
        scratch, counters = self._scratch, frame.arrays["counters"]
        counts, totals = scratch["counts"], scratch["totals"]
        passes = (("keys", "keys", "a"), ("keys_a", "order_a", "b"), ("keys_b", "order_b", "a"))
        for number, (keys, order, out) in enumerate(passes):
            numbers = (count, number * _DIGIT_BITS, number == 0)
            settings = [np.uint32(value) for value in numbers]
            self._run_chunks(program, "count_digits", scratch[keys], counts, counters, *settings)
            self._scan(program, counts, totals, BUCKETS, counters, counter=0)
            self._run_chunks(
                program,
                "scatter_digits",
                *scratch.all(keys, order, f"keys_{out}", f"order_{out}"),
                *(counts, totals, counters, *settings),
            )

    def _bin(self, program: Program, frame: Frame, pair_capacity: int) -> None:
        arrays, scratch = frame.arrays, self._scratch
        counters, counts, order = arrays["counters"], scratch["counts"], scratch["order_a"]
        tiles = frame.tiles[0] * frame.tiles[1]
        size = (np.uint32(tiles), np.int32(frame.tiles[0]))
        chunk_pairs = scratch["chunk_pairs"]
        self._run_chunks(
            program,
            "count_tiles",
            *(arrays["records"], scratch["covers"], order, counts, chunk_pairs, counters),
            *(*size, np.uint32(frame.pair_limit)),
        )
        self._scan(program, counts, arrays["tile_starts"], tiles, counters, counter=2)
        self._scan_buckets(program, chunk_pairs, self._chunks, counters, counter=1)
        self._run_chunks(
            program,
            "fill_tiles",
            *(arrays["records"], scratch["covers"], order, counts),
            *(arrays["tile_starts"], chunk_pairs),
            *arrays.all("pairs", "slot_start", "slot_count", "counters"),
            *(*size, np.uint32(pair_capacity)),
        )

    def _scan(
        self,
        program: Program,
        counts: DeviceArray,
        totals: DeviceArray,
        buckets: int,
        counters: DeviceArray,
        counter: int,
    ) -> None:
        program.run(
            "scan_chunks",
            (-(-buckets // self._group) * self._group,),
            (self._group,),
            counts,
            totals,
            np.uint32(buckets),
            np.uint32(self._chunks),
        )
        self._scan_buckets(program, totals, buckets, counters, counter)

    def _scan_buckets(
        self,
        program: Program,
        totals: DeviceArray,
        buckets: int,
        counters: DeviceArray,
        counter: int,
    ) -> None:
        items = (self._items,)
        program.run(
            "scan_buckets", items, items, totals, counters, np.uint32(buckets), np.uint32(counter)
        )

    def _run_chunks(self, program: Program, kernel: str, *arguments: Any) -> None:
        group = self._chunk_group
        program.run(kernel, (self._chunks * group,), (group,), *arguments)
