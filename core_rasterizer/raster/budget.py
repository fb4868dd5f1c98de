"""How much memory a render may take: estimated before anything is allocated, refused with numbers."""

from __future__ import annotations

import torch

from ..errors import MemoryBudgetError
from .block import Block
from .frame import Frame
from .pose import POSE_NUMBERS

RECORD = 16
"""Numbers in a Gaussian's record, and in a pair's sums."""
PAIR_LIMIT = 3 * 2**30
"""Pairs that 32-bit indices can count, with room for the margin of growing arrays."""


class Budget:
    """The memory of one render and its backward pass.

    Args:
        limit: bytes.
        dtype: of the kernels.
        table: entries of one row of the tables of counts, the number of tiles aside.
        chunks: rows of those tables.
        lanes: Gaussians of a block.
    """

    def __init__(self, limit: int, dtype: torch.dtype, table: int, chunks: int, lanes: int) -> None:
        self.limit = limit
        self._real = dtype.itemsize
        self._table, self._chunks, self._lanes = table, chunks, lanes

    @property
    def bytes_of_pair(self) -> int:
        """A pair takes 8 bytes in the list and a record of sums in the backward pass."""
        return 8 + RECORD * self._real

    def pair_limit(self, frame: Frame, block: Block) -> int:
        """How many (tile, Gaussian) pairs fit beside the image and the Gaussians.

        Raises:
            MemoryBudgetError: not even the image and the Gaussians fit.
        """
        camera = frame.request.camera
        # Three images, the transmittance, and five numbers a pixel of gradients.
        pixels = camera.width * camera.height * 11 * self._real
        # Record, cover, sort keys and orders, slots; the tables of counts, a row a chunk.
        gaussians = block.capacity * (RECORD * self._real + 16 + 5 * 4 + 2 * 4 + 1)
        counts = 4 * self._chunks * max(self._table, frame.tiles[0] * frame.tiles[1])
        # What each block adds to the gradient of the pose.
        posed = frame.request.wants_pose_gradient
        poses = block.capacity // self._lanes * POSE_NUMBERS * 8 if posed else 0
        needed = pixels + gaussians + counts + poses
        if needed > self.limit:
            raise self._exceeded(
                frame, block, f"needs {needed / 2**20:,.0f} MB before its first Gaussian is drawn"
            )
        return min(PAIR_LIMIT, (self.limit - needed) // self.bytes_of_pair)

    def grown(self, frame: Frame, block: Block) -> int:
        """Room to make for the pairs that a render turned out to have, with a margin.

        Raises:
            MemoryBudgetError: they are more than the limit.
        """
        if frame.pairs > frame.pair_limit:
            needed = frame.pair_limit * self.bytes_of_pair / 2**20
            raise self._exceeded(
                frame,
                block,
                f"has more than {frame.pair_limit:,} (tile, Gaussian) pairs, which need {needed:,.0f} MB "
                "beside the images",
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
