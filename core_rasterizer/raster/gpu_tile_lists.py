"""Lists of the Gaussians that can touch each tile, built by the work-groups of a GPU."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import torch

from ..device import Device, DeviceArray, Launch, Program
from ..layout import COUNTERS
from .frame import Frame
from .tile_lists import TileLists

MACROS: Mapping[str, int] = MappingProxyType({})
"""Further macros, for tests."""
_OF_PAIRS = ("tiles_a", "slots_a", "tiles_b", "slots_b", "gaussians")
_ALL, _VISIBLE, _PAIRS = -1, COUNTERS.first["visible"], COUNTERS.first["pairs"]
"""Number of elements to sort: that of the launch, or a counter."""


class Runs(NamedTuple):
    """Division of an array for a prefix sum: at most `group` runs of 2^bits entries."""

    bits: int
    number: int

    @classmethod
    def of(cls, entries: int, group: int) -> Runs:
        """The shortest runs, of at least one entry per work-item."""
        bits = max(group, -(-entries // group)) - 1
        return cls(bits.bit_length(), max(1, -(-entries >> bits.bit_length())))


class GpuTileLists(TileLists):
    """A stable radix sort by depth, pairs by prefix sums, and a stable radix sort of the pairs by tile.

    Every work-item takes an equal share of the Gaussians, the candidates and the pairs; see
    `pairs_gpu.cl`. The lists equal those of `CpuTileLists` bit for bit.
    """

    sources = ("raster/group_scan", "raster/sort_gpu", "raster/pairs_gpu")

    def __init__(self, device: Device) -> None:
        super().__init__(device)
        profile = self._profile
        self._group, self._chunks_for = profile.list_group, profile.list_chunks
        self.macros = {
            "DIGIT_BITS": profile.digit_bits,
            "LIST_GROUP": self._group,
            **MACROS,
        }
        # The entry, scratch memory, and a share of the table of counts.
        self.bytes_of_pair = 8 + 4 * len(_OF_PAIRS) + 4 * self._buckets // profile.list_chunk

    def _sizes(self, capacity: int, tiles: int) -> dict[str, tuple[torch.dtype, int]]:
        words = {
            **dict.fromkeys(("keys", "keys_a", "order_a", "keys_b", "order_b"), capacity),
            "covers": 4 * capacity,
            "counts": self._chunks_for(capacity) * self._buckets,
            "chunk_pairs": self._profile.max_list_chunks + 1,
        }
        return {
            **{name: (torch.int32, elements) for name, elements in words.items()},
            "offsets": (torch.int64, capacity),
            "totals": (torch.int64, self._group),
        }

    def _launches(
        self, program: Program, frame: Frame, count: int, pair_capacity: int
    ) -> Iterator[Launch]:
        bits = max(1, (frame.tiles[0] * frame.tiles[1] - 1).bit_length())
        passes = -(-bits // self._profile.digit_bits)
        bits = -(-bits // passes)
        for name in _OF_PAIRS:
            self._scratch.reserve(name, torch.int32, pair_capacity)
        self._scratch.reserve("counts", torch.int32, self._chunks_for(pair_capacity) << bits)
        counters = frame.arrays["counters"]
        digit_bits = self._profile.digit_bits
        depths = (("keys", "keys", "a"), ("keys_a", "order_a", "b"), ("keys_b", "order_b", "a"))
        for number, (keys, order, out) in enumerate(depths):
            arrays = self._to_sort(keys, order, f"keys_{out}", f"order_{out}")
            of = _VISIBLE if number else _ALL
            yield from self._sort(program, arrays, counters, of, count, number, digit_bits)
        yield from self._emit(program, frame, count, pair_capacity)
        sides = ("a", "b")
        for number in range(passes):
            here, there = sides[number % 2], sides[(number + 1) % 2]
            names = (f"tiles_{here}", f"slots_{here}", f"tiles_{there}", f"slots_{there}")
            arrays = self._to_sort(*names)
            yield from self._sort(program, arrays, counters, _PAIRS, pair_capacity, number, bits)
        last = sides[passes % 2]
        yield self._prepare(
            program,
            "finish_lists",
            self._chunks_for(pair_capacity),
            tiles=self._scratch[f"tiles_{last}"],
            slots=self._scratch[f"slots_{last}"],
            gaussians=self._scratch["gaussians"],
            **frame.arrays.named("tile_starts", "pairs", "counters"),
            tile_count=frame.tiles[0] * frame.tiles[1],
            pair_capacity=pair_capacity,
        )

    def _to_sort(self, *names: str) -> dict[str, DeviceArray]:
        """Arguments of a sort: scratch arrays by the kernel's names."""
        arrays = self._scratch.named(*names)
        roles = ("keys", "values", "keys_out", "values_out")
        return {role: arrays[name] for role, name in zip(roles, names, strict=True)}

    def _sort(
        self,
        program: Program,
        arrays: dict[str, DeviceArray],
        counters: DeviceArray,
        counter: int,
        limit: int,
        number: int,
        bits: int,
    ) -> Iterator[Launch]:
        """One pass of a radix sort.

        Args:
            arrays: see `_to_sort`.
            counter: number of elements, see `_ALL`; none if it exceeds the limit.
            limit: capacity of the arrays.
            number: of the pass, from 0; in the first, values are the elements' indices.
            bits: of a digit.
        """
        counts, totals = self._scratch["counts"], self._scratch["totals"]
        chunks = self._chunks_for(limit)
        runs = Runs.of(chunks << bits, self._group)
        shared: dict[str, DeviceArray | float] = {
            "counts": counts,
            "counters": counters,
            "counter": counter,
            "limit": limit,
            "shift": number * bits,
            "digits": 1 << bits,
        }
        yield self._prepare(program, "count_digits", chunks, keys=arrays["keys"], **shared)
        scanned: dict[str, DeviceArray | float] = {"totals": totals, "run_bits": runs.bits}
        entries = chunks << bits
        yield self._prepare(
            program, "scan_runs", runs.number, table=counts, entries=entries, **scanned
        )
        place = {"first": number == 0, "runs": runs.number}
        yield self._prepare(
            program, "scatter_digits", chunks, **arrays, **shared, **scanned, **place
        )

    def _emit(
        self, program: Program, frame: Frame, count: int, pair_capacity: int
    ) -> Iterator[Launch]:
        """Write tile and Gaussian of every pair, in the order of slots, and count them."""
        # Long thin Gaussians have many more candidates than pairs: let at least every unit take part.
        units = min(self._profile.max_list_chunks, self._device.compute_units)
        chunks = max(self._chunks_for(pair_capacity), units)
        runs = Runs.of(count, self._group)
        shared: dict[str, DeviceArray | float] = {
            **self._scratch.named("covers", "offsets", "totals", "chunk_pairs"),
            "order": self._scratch["order_a"],
            "counters": frame.arrays["counters"],
            "run_bits": runs.bits,
        }
        yield self._prepare(program, "scan_candidates", runs.number, **shared, pair_chunks=chunks)
        shared |= {"records": frame.arrays["records"], "runs": runs.number}
        yield self._prepare(program, "count_pairs", chunks, **shared, pair_limit=frame.pair_limit)
        yield self._prepare(
            program,
            "emit_pairs",
            chunks,
            **shared,
            **frame.arrays.named("slot_start", "slot_count"),
            tiles=self._scratch["tiles_a"],
            gaussians=self._scratch["gaussians"],
            tiles_x=frame.tiles[0],
            pair_capacity=pair_capacity,
        )

    def _prepare(self, program: Program, kernel: str, chunks: int, /, **arguments: Any) -> Launch:
        return program.prepare(kernel, (chunks * self._group,), (self._group,), **arguments)
