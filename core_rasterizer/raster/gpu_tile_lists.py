"""Lists of the Gaussians that can touch each tile, built by the work-groups of a GPU."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import torch

from ..device import Device, DeviceArray, Program
from .frame import Frame
from .tile_lists import BUCKETS, DIGIT_BITS, TileLists

GROUP = 256
"""Work-items per chunk."""
CHUNK = 2048
"""Elements per chunk, so that a work-item takes eight, however many there are."""
MAX_CHUNKS = 4096
"""More elements make larger chunks instead, so that tables of counts stay small."""
MACROS: Mapping[str, int] = MappingProxyType({"DIGIT_BITS": DIGIT_BITS, "LIST_GROUP": GROUP})
_OF_PAIRS = ("tiles_a", "slots_a", "tiles_b", "slots_b", "gaussians")
_ALL, _VISIBLE, _PAIRS = -1, 0, 1
"""Number of elements to sort: that of the launch, or a counter."""


def chunks_for(elements: int) -> int:
    """Number of chunks of an array that may have this many elements."""
    return min(MAX_CHUNKS, max(1, -(-elements // CHUNK)))


class Runs(NamedTuple):
    """Division of an array for a prefix sum: at most `GROUP` runs of 2^bits entries."""

    bits: int
    number: int

    @classmethod
    def of(cls, entries: int) -> Runs:
        """The shortest runs, of at least one entry per work-item."""
        bits = max(GROUP, -(-entries // GROUP)) - 1
        return cls(bits.bit_length(), max(1, -(-entries >> bits.bit_length())))


class GpuTileLists(TileLists):
    """A stable radix sort by depth, pairs by prefix sums, and a stable radix sort of the pairs by tile.

    Every work-item takes an equal share of the Gaussians, the candidates and the pairs; see
    `pairs_gpu.cl`. The lists equal those of `CpuTileLists` bit for bit.
    """

    sources = ("raster/group_scan", "raster/sort_gpu", "raster/pairs_gpu")
    # The entry, scratch memory, and a share of the table of counts.
    bytes_of_pair = 8 + 4 * len(_OF_PAIRS) + 4 * BUCKETS // CHUNK

    def __init__(self, device: Device) -> None:
        super().__init__(device)
        self.macros = MACROS

    def _sizes(self, capacity: int, tiles: int) -> dict[str, tuple[torch.dtype, int]]:
        words = {
            **dict.fromkeys(("keys", "keys_a", "order_a", "keys_b", "order_b"), capacity),
            "covers": 4 * capacity,
            "counts": chunks_for(capacity) * BUCKETS,
            "chunk_pairs": MAX_CHUNKS + 1,
        }
        return {
            **{name: (torch.int32, elements) for name, elements in words.items()},
            "offsets": (torch.int64, capacity),
            "totals": (torch.int64, GROUP),
        }

    def build(self, program: Program, frame: Frame, count: int, pair_capacity: int) -> None:
        bits = max(1, (frame.tiles[0] * frame.tiles[1] - 1).bit_length())
        passes = -(-bits // DIGIT_BITS)
        bits = -(-bits // passes)
        for name in _OF_PAIRS:
            self._scratch.reserve(name, torch.int32, pair_capacity)
        self._scratch.reserve("counts", torch.int32, chunks_for(pair_capacity) << bits)
        counters = frame.arrays["counters"]
        lists = self._scratch.all
        for number, arrays in enumerate(
            (
                lists("keys", "keys", "keys_a", "order_a"),
                lists("keys_a", "order_a", "keys_b", "order_b"),
                lists("keys_b", "order_b", "keys_a", "order_a"),
            )
        ):
            of = _VISIBLE if number else _ALL
            self._sort(program, arrays, counters, of, count, number, DIGIT_BITS)
        self._emit(program, frame, count, pair_capacity)
        names = ("a", "b")
        for number in range(passes):
            here, there = names[number % 2], names[(number + 1) % 2]
            arrays = lists(f"tiles_{here}", f"slots_{here}", f"tiles_{there}", f"slots_{there}")
            self._sort(program, arrays, counters, _PAIRS, pair_capacity, number, bits)
        last = names[passes % 2]
        self._run(
            program,
            "finish_lists",
            chunks_for(pair_capacity),
            *lists(f"tiles_{last}", f"slots_{last}", "gaussians"),
            *frame.arrays.all("tile_starts", "pairs", "counters"),
            np.uint32(frame.tiles[0] * frame.tiles[1]),
            np.uint32(pair_capacity),
        )

    def _sort(
        self,
        program: Program,
        arrays: list[DeviceArray],
        counters: DeviceArray,
        counter: int,
        limit: int,
        number: int,
        bits: int,
    ) -> None:
        """One pass of a radix sort.

        Args:
            arrays: keys, values, sorted keys, sorted values.
            counter: number of elements, see `_ALL`; none if it exceeds the limit.
            limit: capacity of the arrays.
            number: of the pass, from 0; in the first, values are the elements' indices.
            bits: of a digit.
        """
        counts, totals = self._scratch.all("counts", "totals")
        chunks, runs = chunks_for(limit), Runs.of(chunks_for(limit) << bits)
        of = (counters, np.int32(counter), np.uint32(limit))
        digit = (np.uint32(number * bits), np.uint32(1 << bits))
        self._run(program, "count_digits", chunks, arrays[0], counts, *of, *digit)
        entries = (np.uint32(chunks << bits), np.uint32(runs.bits))
        self._run(program, "scan_runs", runs.number, counts, totals, *entries)
        rest = (np.uint32(number == 0), np.uint32(runs.number), np.uint32(runs.bits))
        self._run(program, "scatter_digits", chunks, *arrays, counts, totals, *of, *digit, *rest)

    def _emit(self, program: Program, frame: Frame, count: int, pair_capacity: int) -> None:
        """Write tile and Gaussian of every pair, in the order of slots, and count them."""
        # Long thin Gaussians have many more candidates than pairs: let at least every unit take part.
        chunks = max(chunks_for(pair_capacity), min(MAX_CHUNKS, self._device.compute_units))
        runs = Runs.of(count)
        counters, records = frame.arrays.all("counters", "records")
        covers, order, *tables = self._scratch.all(
            "covers", "order_a", "offsets", "totals", "chunk_pairs"
        )
        self._run(
            program,
            "scan_candidates",
            runs.number,
            *(covers, order, *tables, counters),
            *(np.uint32(chunks), np.uint32(runs.bits)),
        )
        division = (np.uint32(runs.number), np.uint32(runs.bits))
        inputs = (records, covers, order, *tables)
        self._run(
            program,
            "count_pairs",
            chunks,
            *(*inputs, counters, *division, np.uint32(frame.pair_limit)),
        )
        self._run(
            program,
            "emit_pairs",
            chunks,
            *inputs,
            *self._scratch.all("tiles_a", "gaussians"),
            *frame.arrays.all("slot_start", "slot_count", "counters"),
            *division,
            np.int32(frame.tiles[0]),
            np.uint32(pair_capacity),
        )

    def _run(self, program: Program, kernel: str, chunks: int, *arguments: Any) -> None:
        program.run(kernel, (chunks * GROUP,), (GROUP,), *arguments)
