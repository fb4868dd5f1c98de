"""What the host adds to every edit: the limit on Gaussians."""

from __future__ import annotations

import torch
from torch import Tensor

from core_rasterizer import Edit


def limited(edit: Edit, limit: int, rank: Tensor) -> tuple[Edit, int]:
    """The edit without the clones and splits that would go beyond a number of Gaussians.

    Every clone and every split adds one. Those of the highest rank are kept; equal ranks go by
    index, so that the choice is the same in every run.

    Args:
        limit: the largest number of Gaussians after the edit.
        rank: `[N]`, for example the screen-space gradient.

    Returns:
        The edit, and how many Gaussians fewer it adds.
    """
    count = rank.shape[0]
    none = torch.zeros(count, dtype=torch.bool)
    prune = none if edit.prune is None else edit.prune
    clone = (none if edit.clone is None else edit.clone) & ~prune
    split = (none if edit.split is None else edit.split) & ~prune
    added = clone.int() + split.int()
    room = max(0, limit - (count - int(prune.sum())))
    excess = int(added.sum()) - room
    if excess <= 0:
        return edit, 0
    order = torch.argsort(rank, descending=True, stable=True)
    fits = torch.zeros_like(none)
    fits[order] = added[order].cumsum(0) <= room
    kept = Edit(clone=clone & fits, split=split & fits, prune=edit.prune)
    return kept, int(added[~fits].sum())
