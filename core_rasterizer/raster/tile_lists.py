"""Lists, for each tile of an image, the Gaussians that can touch it, nearest first."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from ..device import Device, DeviceArray, Program, Scratch
from .frame import Frame

_ON_CPU = ("raster/scan", "raster/sort", "raster/bin", "raster/lists_of_few")
_ON_GPU = ("raster/scan", "raster/sort_gpu", "raster/bin_gpu")
_GPU_CHUNK_GROUP = 64
"""Work-items that share a chunk on a GPU: each looks at all those before it to find its place among them."""

_DIGIT_BITS = 11
BUCKETS = 1 << _DIGIT_BITS
"""Entries of the sort's tables of counts; a row a chunk, like those of the tiles."""
FEW = 1 << 14
"""Up to so many Gaussians are sorted and binned by one work-item of a CPU, in one launch instead of
fourteen. Beyond twice as many, work shared by two cores outweighs what the launches cost."""


def chunks_of(device: Device) -> int:
    """How many runs of neighbouring Gaussians are sorted and binned side by side.

    Each belongs to a work-item of a CPU, or to a work-group of a GPU. There are enough of them for every
    unit, and few enough for the sums over them; on a GPU that is an estimate, not a measurement.
    """
    if device.variant == "cpu":
        return min(16, 2 * device.compute_units)
    return min(256, 2 * device.compute_units)


class TileLists:
    """Sorts the visible Gaussians by depth, and bins them by tile in that order.

    Args:
        device: where to run; its variant decides how work is shared out.

    Attributes:
        sources: the kernels' files; they build on "raster/scene" and "raster/cover".
        macros: what the kernels must be built with.
    """

    def __init__(self, device: Device) -> None:
        self._device = device
        self._chunks = chunks_of(device)
        on_cpu = device.variant == "cpu"
        self._few = FEW if on_cpu else -1  # not even none
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
        """Make room for a render's Gaussians and tiles."""
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
        """Sort keys, which the projection writes: `[capacity]`, 32 bits."""
        return self._scratch["keys"]

    @property
    def covers(self) -> DeviceArray:
        """Tiles that each Gaussian can touch, which the projection writes: `[4 * capacity]`, 32 bits."""
        return self._scratch["covers"]

    def build(self, program: Program, frame: Frame, count: int, pair_capacity: int) -> None:
        """Fill `frame.arrays["pairs"]`, unless there are more pairs than it has room for.

        The numbers of visible Gaussians and of pairs are left in `frame.arrays["counters"]`.
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
            *(
                scratch[name]
                for name in ("covers", "keys", "keys_a", "order_a", "keys_b", "order_b")
            ),
            scratch["counts"],
            *(
                arrays[name]
                for name in ("tile_starts", "pairs", "slot_start", "slot_count", "counters")
            ),
            np.uint32(count),
            np.uint32(frame.tiles[0] * frame.tiles[1]),
            np.int32(frame.tiles[0]),
            np.uint32(frame.pair_limit),
            np.uint32(pair_capacity),
        )

    def _sort(self, program: Program, frame: Frame, count: int) -> None:
        """Leave the visible Gaussians, nearest first, in the scratch array `order_a`."""
        scratch, counters = self._scratch, frame.arrays["counters"]
        counts, totals = scratch["counts"], scratch["totals"]
        passes = (("keys", "keys", "a"), ("keys_a", "order_a", "b"), ("keys_b", "order_b", "a"))
        for number, (keys, order, out) in enumerate(passes):
            settings = (
                np.uint32(count),
                np.uint32(number * _DIGIT_BITS),
                np.uint32(number == 0),
            )
            self._run_chunks(program, "count_digits", scratch[keys], counts, counters, *settings)
            self._scan(program, counts, totals, BUCKETS, counters, counter=0)
            self._run_chunks(
                program,
                "scatter_digits",
                scratch[keys],
                scratch[order],
                scratch[f"keys_{out}"],
                scratch[f"order_{out}"],
                counts,
                totals,
                counters,
                *settings,
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
            arrays["records"],
            scratch["covers"],
            order,
            counts,
            chunk_pairs,
            counters,
            *size,
            np.uint32(frame.pair_limit),
        )
        self._scan(program, counts, arrays["tile_starts"], tiles, counters, counter=2)
        self._scan_buckets(program, chunk_pairs, self._chunks, counters, counter=1)
        self._run_chunks(
            program,
            "fill_tiles",
            arrays["records"],
            scratch["covers"],
            order,
            counts,
            arrays["tile_starts"],
            chunk_pairs,
            arrays["pairs"],
            arrays["slot_start"],
            arrays["slot_count"],
            counters,
            *size,
            np.uint32(pair_capacity),
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
