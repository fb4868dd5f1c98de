"""Limits of growth: the number of Gaussians, and the last iteration."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from core_rasterizer import Edit, Gaussians
from core_rasterizer.layout import PARAMETERS


def limited(edit: Edit, limit: int, rank: Tensor) -> tuple[Edit, int]:
    """Reduce an edit so that the number of Gaussians stays within a limit.

    A clone adds one Gaussian, a split one fewer than it has children. Clones and splits are dropped first,
    those of the lowest rank first; equal ranks are ordered by index, so that the choice is deterministic.
    Then added Gaussians are dropped, the last first.

    Args:
        limit: the largest number of Gaussians after the edit.
        rank: `[N]`, for example the screen-space gradient.

    Returns:
        The edit, and the number of Gaussians dropped.
    """
    count = rank.shape[0]
    clone, split, prune = (edit.mask(name, count) for name in ("clone", "split", "prune"))
    grown = clone.int() + split.int() * (edit.split_into - 1)
    added = 0 if edit.add is None else len(edit.add)
    room = max(0, limit - (count - int(prune.sum())))
    if int(grown.sum()) + added <= room:
        return edit, 0
    kept_added = min(added, room)
    order = torch.argsort(rank, descending=True, stable=True)
    fits = torch.zeros_like(prune)
    fits[order] = grown[order].cumsum(0) <= room - kept_added
    kept = replace(_with_added(edit, kept_added), clone=clone & fits, split=split & fits)
    return kept, int(grown[~fits].sum()) + added - kept_added


def without_growth(edit: Edit) -> Edit:
    """Return the edit without clones, splits and added Gaussians, for the last iteration.

    New Gaussians would not be trained: a child of a split may lie in front of a camera, and stay there.
    """
    return replace(edit, clone=None, split=None, add=None, parents=None)


def _with_added(edit: Edit, number: int) -> Edit:
    """Return the edit with only the first of its added Gaussians."""
    if edit.add is None or edit.parents is None:
        return edit
    first = {name: getattr(edit.add, name)[:number] for name in PARAMETERS}
    return replace(edit, add=Gaussians(**first), parents=edit.parents[:number])
