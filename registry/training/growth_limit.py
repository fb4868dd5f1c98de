"""Limits of growth: the number of Gaussians, and the last iteration."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from core_rasterizer import Edit, Gaussians
from core_rasterizer.layout import PARAMETERS


def limited(edit: Edit, limit: int, rank: Tensor) -> tuple[Edit, int]:
    """Return an edit after which there are at most `limit` Gaussians, and how many it adds less than before.

    Clones and splits are dropped first: those of the lowest `rank` `[N]`, and of equal ranks those of the
    highest index. Then added Gaussians are dropped, the last first.
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
    kept = replace(edit, clone=clone & fits, split=split & fits)
    if edit.add is not None and edit.parents is not None:
        first = {name: getattr(edit.add, name)[:kept_added] for name in PARAMETERS}
        kept = replace(kept, add=Gaussians(**first), parents=edit.parents[:kept_added])
    return kept, int(grown[~fits].sum()) + added - kept_added


def without_growth(edit: Edit) -> Edit:
    """Return the edit without clones, splits and added Gaussians, for the last iteration.

    New Gaussians would not be trained: a child of a split may lie in front of a camera, and stay there.
    """
    return replace(edit, clone=None, split=None, add=None, parents=None)
