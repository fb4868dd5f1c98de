"""Lists of the Gaussians that can touch each tile of an image, nearest first."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from typing import Any

import torch

from ..device import Device, DeviceArray, Launch, Program, Scratch
from ..layout import COUNTERS
from .frame import Frame

_OF_FRAME = ("records", "tile_starts", "pairs", "slot_start", "slot_count", "counters")
"""Arrays of a frame that the lists are built in."""


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
        self._device, self._profile = device, device.profile
        self._buckets = 1 << self._profile.digit_bits
        self._scratch = Scratch(device)
        self._reserved_for = (0, 0)
        self._bytes_for = ((0, 0), 0)

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
        if self._reserved_for != (capacity, tiles):
            for name, (dtype, elements) in self._sizes(capacity, tiles).items():
                self._scratch.reserve(name, dtype, elements)
            self._reserved_for = capacity, tiles

    def bytes_for(self, capacity: int, tiles: int) -> int:
        """Scratch memory of `reserve`."""
        if self._bytes_for[0] != (capacity, tiles):
            sizes = self._sizes(capacity, tiles).values()
            needed = sum(dtype.itemsize * elements for dtype, elements in sizes)
            self._bytes_for = (capacity, tiles), needed
        return self._bytes_for[1]

    def build(self, program: Program, frame: Frame, count: int, pair_capacity: int) -> None:
        """Fill `frame.arrays["pairs"]`, unless it is too small for all pairs.

        Writes the numbers of visible Gaussians and of pairs to `frame.arrays["counters"]`.
        """
        numbers = count, pair_capacity, frame.pair_limit, frame.tiles
        arrays = frame.arrays.named(*_OF_FRAME).values()
        if not frame.lists.is_for(program, *numbers, *arrays, *self._scratch.all):
            launches = tuple(self._launches(program, frame, count, pair_capacity))
            frame.lists.prepare(launches, program, *numbers, *arrays, *self._scratch.all)
        frame.lists.enqueue(self._device)

    @abstractmethod
    def _launches(
        self, program: Program, frame: Frame, count: int, pair_capacity: int
    ) -> Iterator[Launch]:
        """What `build` enqueues; may reserve more scratch memory."""

    @abstractmethod
    def _sizes(self, capacity: int, tiles: int) -> dict[str, tuple[torch.dtype, int]]:
        """Types and lengths of the scratch arrays."""


class CpuTileLists(TileLists):
    """On a CPU: a stable counting sort, one work-item per chunk of neighbouring Gaussians."""

    sources = ("raster/scan", "raster/sort", "raster/bin", "raster/lists_of_few")
    bytes_of_pair = 8

    def __init__(self, device: Device) -> None:
        super().__init__(device)
        self._chunks = self._profile.chunks
        self.macros = {
            "DIGIT_BITS": self._profile.digit_bits,
            "SCAN_GROUP": self._profile.scan_group,
            "SCAN_ITEMS": 1,
        }

    def _sizes(self, capacity: int, tiles: int) -> dict[str, tuple[torch.dtype, int]]:
        sizes = {
            **dict.fromkeys(("keys", "keys_a", "order_a", "keys_b", "order_b"), capacity),
            "covers": 4 * capacity,
            "counts": self._chunks * max(self._buckets, tiles),
            "totals": self._buckets + 1,
            "chunk_pairs": self._chunks + 1,
        }
        return {name: (torch.int32, elements) for name, elements in sizes.items()}

    def _launches(
        self, program: Program, frame: Frame, count: int, pair_capacity: int
    ) -> Iterator[Launch]:
        if count <= self._profile.few:
            yield self._alone(program, frame, count, pair_capacity)
        else:
            yield from self._sort(program, frame, count)
            yield from self._bin(program, frame, pair_capacity)

    def _alone(self, program: Program, frame: Frame, count: int, pair_capacity: int) -> Launch:
        arrays, scratch = frame.arrays, self._scratch
        return program.prepare(
            "lists_of_few",
            (1,),
            (1,),
            **scratch.named("covers", "keys", "keys_a", "order_a", "keys_b", "order_b", "counts"),
            **arrays.named("records", "tile_starts", "pairs"),
            **arrays.named("slot_start", "slot_count", "counters"),
            count=count,
            tiles=frame.tiles[0] * frame.tiles[1],
            tiles_x=frame.tiles[0],
            pair_limit=frame.pair_limit,
            pair_capacity=pair_capacity,
        )

    def _sort(self, program: Program, frame: Frame, count: int) -> Iterator[Launch]:
        """Write the visible Gaussians, nearest first, to the scratch array `order_a`."""
        scratch, counters = self._scratch, frame.arrays["counters"]
        counts, totals = scratch["counts"], scratch["totals"]
        passes = (("keys", "keys", "a"), ("keys_a", "order_a", "b"), ("keys_b", "order_b", "a"))
        for number, (keys, order, out) in enumerate(passes):
            shared: dict[str, DeviceArray | float] = {
                "keys": scratch[keys],
                "counts": counts,
                "counters": counters,
                "count": count,
                "shift": number * self._profile.digit_bits,
                "first": number == 0,
            }
            yield self._on_chunks(program, "count_digits", **shared)
            yield from self._scan(program, counts, totals, self._buckets, counters, "visible")
            yield self._on_chunks(
                program,
                "scatter_digits",
                **shared,
                order=scratch[order],
                keys_out=scratch[f"keys_{out}"],
                order_out=scratch[f"order_{out}"],
                starts=totals,
            )

    def _bin(self, program: Program, frame: Frame, pair_capacity: int) -> Iterator[Launch]:
        arrays, scratch = frame.arrays, self._scratch
        counters, counts = arrays["counters"], scratch["counts"]
        tiles = frame.tiles[0] * frame.tiles[1]
        chunk_pairs = scratch["chunk_pairs"]
        shared: dict[str, DeviceArray | float] = {
            **arrays.named("records", "counters"),
            **scratch.named("covers", "counts"),
            "order": scratch["order_a"],
            "tiles": tiles,
            "tiles_x": frame.tiles[0],
        }
        limit = frame.pair_limit
        yield self._on_chunks(
            program, "count_tiles", **shared, chunk_pairs=chunk_pairs, pair_limit=limit
        )
        yield from self._scan(program, counts, arrays["tile_starts"], tiles, counters, "listed")
        yield self._scan_buckets(program, chunk_pairs, self._chunks, counters, "pairs")
        yield self._on_chunks(
            program,
            "fill_tiles",
            **shared,
            **arrays.named("tile_starts", "pairs", "slot_start", "slot_count"),
            chunk_starts=chunk_pairs,
            pair_capacity=pair_capacity,
        )

    def _scan(
        self,
        program: Program,
        counts: DeviceArray,
        totals: DeviceArray,
        buckets: int,
        counters: DeviceArray,
        counter: str,
    ) -> Iterator[Launch]:
        group = self._profile.scan_group
        yield program.prepare(
            "scan_chunks",
            (-(-buckets // group) * group,),
            (group,),
            counts=counts,
            totals=totals,
            buckets=buckets,
            chunks=self._chunks,
        )
        yield self._scan_buckets(program, totals, buckets, counters, counter)

    def _scan_buckets(
        self,
        program: Program,
        totals: DeviceArray,
        buckets: int,
        counters: DeviceArray,
        counter: str,
    ) -> Launch:
        return program.prepare(
            "scan_buckets",
            (1,),
            (1,),
            totals=totals,
            counters=counters,
            buckets=buckets,
            counter=COUNTERS.first[counter],
        )

    def _on_chunks(self, program: Program, kernel: str, /, **arguments: Any) -> Launch:
        return program.prepare(kernel, (self._chunks,), (1,), **arguments)
