"""Which training view comes next: shuffled, without replacement, with a generator of its own."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from ..errors import RunError


class ViewOrder:
    """Draws every view once before any comes again (3DGS).

    Args:
        count: how many views there are, >= 1.
        seed: of the shuffles.
    """

    def __init__(self, count: int, seed: int) -> None:
        self._count = count
        self._generator = torch.Generator().manual_seed(seed)
        self._left = torch.empty(0, dtype=torch.int64)

    def next(self) -> int:
        """The index of the next view."""
        if not len(self._left):
            self._left = torch.randperm(self._count, generator=self._generator)
        index, self._left = int(self._left[0]), self._left[1:]
        return index

    def state(self) -> dict[str, Tensor]:
        """For a checkpoint."""
        return {"generator": self._generator.get_state(), "left": self._left.clone()}

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Take back what `state` returned.

        Raises:
            RunError: it names views that there are not.
        """
        left = state["left"].clone()
        numbers = left.tolist()
        if left.ndim != 1 or not set(numbers) <= set(range(self._count)):
            raise RunError(f"the views that are left, {numbers}, are not of these {self._count}")
        self._generator.set_state(state["generator"])
        self._left = left
