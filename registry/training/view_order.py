"""Order of the training views: shuffled, without replacement, with its own random generator."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from ..errors import RunError


class ViewOrder:
    """Draws every view once before any is repeated (3DGS).

    Args:
        count: number of views, >= 1.
        seed: seed of the shuffles.
    """

    def __init__(self, count: int, seed: int) -> None:
        self._count = count
        self._generator = torch.Generator().manual_seed(seed)
        self._left = torch.empty(0, dtype=torch.int64)

    def next(self) -> int:
        """Return the index of the next view."""
        if not len(self._left):
            self._left = torch.randperm(self._count, generator=self._generator)
        index, self._left = int(self._left[0]), self._left[1:]
        return index

    def state(self) -> dict[str, Tensor]:
        """Return the state for a checkpoint."""
        return {"generator": self._generator.get_state(), "left": self._left.clone()}

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Restore the result of `state`.

        Raises:
            RunError: a view does not exist.
        """
        left = state["left"].clone()
        numbers = left.tolist()
        if left.ndim != 1 or not set(numbers) <= set(range(self._count)):
            raise RunError(f"the remaining views, {numbers}, are not among the {self._count} views")
        self._generator.set_state(state["generator"])
        self._left = left
