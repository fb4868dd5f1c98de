"""What `gradient_aware_decay` tells about itself; none of it changes the training."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

PERCENTS = (5, 25, 50, 75, 95)


def quantiles(values: Tensor) -> dict[int, float]:
    """The nearest-rank quantiles of `[N]` values, N >= 1, by percent."""
    ordered = values.sort().values
    last = len(values) - 1
    return {percent: float(ordered[round(percent / 100 * last)]) for percent in PERCENTS}


class UnseenPruned:
    """Counts Gaussians that are pruned though no view gave them a gradient since the last edit.

    Attributes:
        pruned: how many there have been.
    """

    def __init__(self) -> None:
        self.pruned = 0
        self._seen: Tensor | None = None

    def see(self, contributing: Tensor) -> None:
        """Take in one iteration's `[N]` bool: who has a gradient."""
        self._seen = contributing if self._seen is None else self._seen | contributing

    def edit(self, source: Tensor) -> None:
        """Take in a change of topology; `source` `[N_new]` is where each Gaussian comes from."""
        if self._seen is not None:
            pruned = torch.ones_like(self._seen)
            pruned[source] = False
            self.pruned += int((pruned & ~self._seen).sum())
        self._seen = None

    def state(self) -> dict[str, Tensor]:
        """Everything, for a checkpoint."""
        state = {"pruned_unseen": torch.tensor(self.pruned)}
        return state if self._seen is None else {**state, "seen": self._seen}

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Take back what `state` returned."""
        self.pruned = int(state["pruned_unseen"])
        self._seen = state.get("seen")
