"""Lists of the Gaussians that can touch each tile of an image, nearest first."""

from __future__ import annotations

import sys
from abc import ABC, abstractmethod
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
import torch

from ..device import Device, DeviceArray, Program, Scratch
from .frame import Frame

DIGIT_BITS = 11
BUCKETS = 1 << DIGIT_BITS
"""Row length of the sort's table of counts, which has one row per chunk."""
_SCAN_GROUP = 16
_MAX_CHUNKS = 64
FEW = 1 << 13


def chunks_of(device: Device) -> int:
    """Number of chunks of Gaussians that the work-items of a CPU sort and bin in parallel.

    Two per core, so that one that starts late is not waited for long.
    """
    return min(_MAX_CHUNKS, 2 * device.compute_units)


def few(device: Device) -> int:
    """Up to this many Gaussians are sorted and binned by one work-item, in one launch instead of fourteen.

    On two cores the launches take as long as half of the work on 16,384 Gaussians; on c cores the
    others save the share 1 - 1/c.
    """
    others = device.compute_units - 1
    return FEW * (others + 1) // others if others else sys.maxsize


class TileLists(ABC):
    """Sorts the visible Gaussians by depth, and bins them by tile in that order.

    Args:
        device: where to run.

    Attributes:
        sources: the kernels' files; they need "raster/scene" and "raster/cover".
        macros: of the kernels.
        bytes_of_pair: memory for one (tile, Gaussian) pair while the lists are built, and of its entry.
    """

    sources: tuple[str, ...]
    macros: Mapping[str, int]
    bytes_of_pair: int

    def __init__(self, device: Device) -> None:
        self._device = device
        self._scratch = Scratch(device)

    @property
    def keys(self) -> DeviceArray:
        """Sort keys, written by the projection: `[capacity]`, 32 bits."""
        return self._scratch["keys"]

    @property
    def covers(self) -> DeviceArray:
        """Tiles that each Gaussian can touch, written by the projection: `[4 * capacity]`, 32 bits."""
        return self._scratch["covers"]

    def reserve(self, capacity: int, tiles: int) -> None:
        """Allocate scratch memory for a render's Gaussians and tiles."""
        for name, (dtype, elements) in self._sizes(capacity, tiles).items():
            self._scratch.reserve(name, dtype, elements)

    def bytes_for(self, capacity: int, tiles: int) -> int:
        """Scratch memory of `reserve`."""
        sizes = self._sizes(capacity, tiles).values()
        return sum(dtype.itemsize * elements for dtype, elements in sizes)

    @abstractmethod
    def build(self, program: Program, frame: Frame, count: int, pair_capacity: int) -> None:
        """Fill `frame.arrays["pairs"]`, unless it is too small for all pairs.

        Writes the numbers of visible Gaussians and of pairs to `frame.arrays["counters"]`.
        """

    @abstractmethod
    def _sizes(self, capacity: int, tiles: int) -> dict[str, tuple[torch.dtype, int]]:
        """Types and lengths of the scratch arrays."""


class CpuTileLists(TileLists):
    """On a CPU: a stable counting sort, one work-item per chunk of neighbouring Gaussians."""

    sources = ("raster/scan", "raster/sort", "raster/bin", "raster/lists_of_few")
    macros = MappingProxyType(
        {"DIGIT_BITS": DIGIT_BITS, "SCAN_GROUP": _SCAN_GROUP, "SCAN_ITEMS": 1}
    )
    bytes_of_pair = 8

    def __init__(self, device: Device) -> None:
        super().__init__(device)
        self._chunks, self._few = chunks_of(device), few(device)

    def _sizes(self, capacity: int, tiles: int) -> dict[str, tuple[torch.dtype, int]]:
        sizes = {
            **dict.fromkeys(("keys", "keys_a", "order_a", "keys_b", "order_b"), capacity),
            "covers": 4 * capacity,
            "counts": self._chunks * max(BUCKETS, tiles),
            "totals": BUCKETS + 1,
            "chunk_pairs": self._chunks + 1,
        }
        return {name: (torch.int32, elements) for name, elements in sizes.items()}

    def build(self, program: Program, frame: Frame, count: int, pair_capacity: int) -> None:
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
            numbers = (count, number * DIGIT_BITS, number == 0)
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
            (-(-buckets // _SCAN_GROUP) * _SCAN_GROUP,),
            (_SCAN_GROUP,),
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
        program.run(
            "scan_buckets", (1,), (1,), totals, counters, np.uint32(buckets), np.uint32(counter)
        )

    def _run_chunks(self, program: Program, kernel: str, *arguments: Any) -> None:
        program.run(kernel, (self._chunks,), (1,), *arguments)
