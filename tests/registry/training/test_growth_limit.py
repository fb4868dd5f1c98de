"""Edits with a limit for the number of Gaussians."""

from __future__ import annotations

from dataclasses import replace

import torch

from core_rasterizer import Edit, Gaussians, Relocation
from registry.training.growth_limit import limited, without_growth

RANK = torch.tensor([1.0, 5.0, 5.0, 3.0, 9.0])
ALL = torch.ones(5, dtype=torch.bool)


def gaussians(count: int) -> Gaussians:
    """Return Gaussians whose positions identify them."""
    places = torch.arange(3.0 * count).reshape(count, 3)
    return Gaussians.from_points(
        places, torch.zeros(count, 3), torch.ones(count), torch.full((count,), 0.5), 1
    )


def test_growth_is_limited_by_rank_then_index() -> None:
    prune = torch.tensor([False, False, False, False, True])
    edit, dropped = limited(Edit(clone=ALL, prune=prune), 6, RANK)
    assert edit.clone is not None
    assert edit.clone.tolist() == [False, True, True, False, False]
    assert dropped == 2
    untouched = Edit(split=ALL)
    assert limited(untouched, 10, RANK) == (untouched, 0)
    full, dropped = limited(Edit(split=ALL), 3, RANK)
    assert full.split is not None
    assert not full.split.any()
    assert dropped == 5


def test_a_split_counts_as_many_as_it_adds() -> None:
    edit = Edit(split=ALL, split_into=4, shrink=3.2)
    kept, dropped = limited(edit, 5 + 7, RANK)
    assert kept.split is not None
    assert kept.split.tolist() == [False, True, False, False, True]
    assert dropped == 9
    assert (kept.split_into, kept.shrink) == (4, 3.2)
    assert limited(edit, 20, RANK) == (edit, 0)


def test_a_clone_does_not_replace_a_split_of_higher_rank() -> None:
    split = torch.tensor([False, False, False, False, True])
    kept, dropped = limited(Edit(clone=~split, split=split, split_into=3), 6, RANK)
    assert kept.clone is not None
    assert kept.split is not None
    assert not kept.split.any()
    assert not kept.clone.any()
    assert dropped == 6


def test_added_gaussians_are_dropped_after_all_clones_and_the_last_first() -> None:
    parents = torch.tensor([4, 3, 2])
    relocate = Relocation(parents[:1], parents[1:2])
    edit = Edit(clone=ALL, add=gaussians(3), parents=parents, relocate=relocate)
    kept, dropped = limited(edit, 10, RANK)
    assert kept.clone is not None
    assert kept.clone.tolist() == [False, True, False, False, True]
    assert kept.add is not None
    assert len(kept.add) == 3
    assert dropped == 3
    kept, dropped = limited(edit, 7, RANK)
    assert kept.clone is not None
    assert not kept.clone.any()
    assert kept.add is not None
    assert kept.parents is not None
    assert torch.equal(kept.add.means, gaussians(3).means[:2])
    assert kept.parents.tolist() == [4, 3]
    assert kept.relocate is relocate
    assert dropped == 6
    kept.check(5)
    full, dropped = limited(Edit(add=gaussians(3), parents=parents), 4, RANK)
    assert full.empty
    assert dropped == 3
    full.check(5)


def test_pruned_gaussians_make_room() -> None:
    prune = torch.tensor([True, True, False, False, False])
    edit = Edit(prune=prune, add=gaussians(2), parents=torch.tensor([0, 0]))
    assert limited(edit, 5, RANK) == (edit, 0)


def test_without_growth_keeps_the_rest_of_an_edit() -> None:
    parents = torch.tensor([4, 3])
    relocate = Relocation(parents[:1], parents[1:])
    prune = torch.tensor([True, False, False, False, False])
    edit = Edit(clone=ALL, split=ALL, prune=prune, add=gaussians(2), parents=parents)
    kept = without_growth(replace(edit, relocate=relocate))
    kept.check(5)
    assert kept.relocate is relocate
    assert kept.prune is prune
    assert without_growth(replace(edit, prune=None)).empty
