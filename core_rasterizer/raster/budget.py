"""Memory limit of a render, checked before anything is allocated."""

from __future__ import annotations

import torch

from ..errors import MemoryBudgetError
from ..layout import GAUSSIAN, PAIR, POSE
from .block import Block
from .frame import Frame
from .tile_lists import TileLists

PAIR_LIMIT = 3 * 2**30
"""Largest number of pairs for 32-bit indices, with room for the margin of growing arrays."""


class Budget:
    """Memory of one render and its backward pass.

    Args:
        limit: bytes.
        dtype: of the kernels.
        lists: which need scratch memory.
        lanes: Gaussians per block.
        largest_buffer: bytes that the driver allocates at once.
        pair: bytes that the backward pass needs for each pair, apart from its sums.
        tile: the same for each tile.
    """

    def __init__(
        self,
        limit: int,
        dtype: torch.dtype,
        lists: TileLists,
        lanes: int,
        largest_buffer: int,
        pair: int = 0,
        tile: int = 0,
    ) -> None:
        self.limit, self._largest_buffer = limit, largest_buffer
        self._pair, self._tile = pair, tile
        self._real = dtype.itemsize
        self._lists, self._lanes = lists, lanes

    @property
    def bytes_of_pair(self) -> int:
        """Its part of the lists, and a record of sums in the backward pass."""
        return self._lists.bytes_of_pair + PAIR.size * self._real + self._pair

    def pair_limit(self, frame: Frame, block: Block) -> int:
        """Number of (tile, Gaussian) pairs that fit next to the image and the Gaussians.

        Raises:
            MemoryBudgetError: the image and the Gaussians alone do not fit.
        """
        camera = frame.request.camera
        # Three images (5 numbers per pixel), the transmittance, and 5 numbers of gradients.
        pixels = camera.width * camera.height * 11 * self._real
        # Record, slots, clamped colours.
        gaussians = block.capacity * (GAUSSIAN.size * self._real + 2 * 4 + 1)
        tiles = frame.tiles[0] * frame.tiles[1]
        lists = self._lists.bytes_for(block.capacity, tiles) + self._tile * tiles
        # Each block's share of the pose gradient.
        posed = frame.request.wants_pose_gradient
        poses = block.capacity // self._lanes * POSE.size * 8 if posed else 0
        needed = pixels + gaussians + lists + poses
        if needed > self.limit:
            raise self._exceeded(
                frame, block, f"needs {needed / 2**20:,.0f} MB before its first Gaussian is drawn"
            )
        in_one_buffer = self._largest_buffer // (PAIR.size * self._real)
        return min(PAIR_LIMIT, in_one_buffer, (self.limit - needed) // self.bytes_of_pair)

    def grown(self, frame: Frame, block: Block) -> int:
        """New capacity for the pairs that a render has, with a margin.

        Raises:
            MemoryBudgetError: they exceed the limit.
        """
        if frame.pairs > frame.pair_limit:
            needed = frame.pair_limit * self.bytes_of_pair / 2**20
            raise self._exceeded(
                frame,
                block,
                f"has more than {frame.pair_limit:,} (tile, Gaussian) pairs, which need {needed:,.0f} MB "
                f"next to the images, at most {self._largest_buffer / 2**20:,.0f} MB in one buffer",
            )
        return min(frame.pairs + frame.pairs // 4, frame.pair_limit)

    def _exceeded(self, frame: Frame, block: Block, what: str) -> MemoryBudgetError:
        camera = frame.request.camera
        return MemoryBudgetError(
            f"the render {what}; the budget is {self.limit / 2**20:,.0f} MB",
            where=f"{block.count:,} Gaussians in {camera.width}x{camera.height} pixels",
            fix="lower the number or the size of the Gaussians, render fewer pixels, or raise the memory "
            "budget",
        )
