"""Edits of the set of Gaussians, and the mapping from old to new ones."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from ..errors import GaussianError
from ..gaussians import Gaussians


@dataclass(frozen=True, eq=False)
class Relocation:
    """Dead Gaussians that become copies of others (3DGS-MCMC: Kheradmand et al. 2024, section 4).

    A source and its copies get the opacities and scales of the paper's equation 9, so that the image
    stays nearly the same. The optimizer's moments of sources and targets are reset.

    Args:
        source: `[M]` int64, indices of the Gaussians to copy; repeats are allowed.
        target: `[M]` int64, indices of the Gaussians to overwrite, without repeats.
    """

    source: Tensor
    target: Tensor


@dataclass(frozen=True, eq=False)
class Edit:
    """Changes to the Gaussians; masks are boolean `[N]` over the current ones, None selects none.

    Relocation is applied first; the masks select Gaussians after it.

    Args:
        clone: add an exact copy.
        split: replace by smaller Gaussians, drawn from the Gaussian itself.
        prune: remove; overrides the other two.
        split_into: number of children of a split, 2 to 100 (3DGS: 2).
        shrink: divisor of the children's scales, > 0. 3DGS: 1.6, which is 0.8 times the number of
            children.
        add: M new Gaussians of the model's SH degree.
        parents: `[M]` int64, required with `add`: the current Gaussian whose per-Gaussian plugin state
            each added one inherits.
        relocate: Gaussians to overwrite by copies of others.
    """

    clone: Tensor | None = None
    split: Tensor | None = None
    prune: Tensor | None = None
    split_into: int = 2
    shrink: float = 1.6
    add: Gaussians | None = None
    parents: Tensor | None = None
    relocate: Relocation | None = None

    @property
    def empty(self) -> bool:
        """Whether the edit changes nothing."""
        masks = (self.clone, self.split, self.prune)
        return (
            not any(mask is not None and bool(mask.any()) for mask in masks)
            and not (self.add is not None and len(self.add))
            and not (self.relocate is not None and len(self.relocate.target))
        )

    def mask(self, name: str, count: int) -> Tensor:
        """A copy of the mask "clone", "split" or "prune", `[N]` bool; the first two without pruned ones."""
        mask: Tensor | None = getattr(self, name)
        chosen = torch.zeros(count, dtype=torch.bool) if mask is None else mask.clone()
        return chosen if name == "prune" or self.prune is None else chosen & ~self.prune

    def check(self, count: int) -> None:
        """Raise if the edit does not fit `count` Gaussians.

        Raises:
            GaussianError: names the field and, if any, the index.
        """
        for name in ("clone", "split", "prune"):
            mask = getattr(self, name)
            if mask is not None:
                _check_tensor(name, mask, torch.bool, count)
        if not isinstance(self.split_into, int) or not 2 <= self.split_into <= 100:
            raise GaussianError(
                f"split_into is {self.split_into}",
                field="split_into",
                fix="use a whole number of children, from 2 to 100",
            )
        if not (math.isfinite(self.shrink) and self.shrink > 0):
            raise GaussianError(
                f"shrink is {self.shrink}",
                field="shrink",
                fix="use a positive number, such as 1.6",
            )
        self._check_added(count)
        if self.relocate is not None:
            self._check_relocation(self.relocate, count)

    def _check_added(self, count: int) -> None:
        if (self.add is None) != (self.parents is None):
            given, missing = ("add", "parents") if self.parents is None else ("parents", "add")
            raise GaussianError(f"{given!r} is given without {missing!r}", field=missing)
        if self.add is None or self.parents is None:
            return
        if not isinstance(self.add, Gaussians):
            raise GaussianError(
                f"'add' is a {type(self.add).__name__}, expected Gaussians", field="add"
            )
        self.add.check_finite()
        _check_tensor("parents", self.parents, torch.int64, len(self.add))
        _check_indices("parents", self.parents, count)

    def _check_relocation(self, move: Relocation, count: int) -> None:
        moved = move.target.shape[0] if move.target.ndim else 0
        for name, indices in (("target", move.target), ("source", move.source)):
            field = f"relocate.{name}"
            _check_tensor(field, indices, torch.int64, moved)
            _check_indices(field, indices, count)
            if self.prune is not None:
                _refuse(field, indices, self.prune[indices], "is also pruned")
        times = torch.bincount(move.target, minlength=count)
        _refuse("relocate.target", move.target, times[move.target] > 1, "is a target twice")
        copied = torch.zeros(count, dtype=torch.bool)
        copied[move.source] = True
        _refuse("relocate.target", move.target, copied[move.target], "is also a source")


@dataclass(frozen=True, eq=False)
class Carried:
    """Origin of the Gaussians after an edit.

    Args:
        source: `[N_new]` int64, index before the edit: of a relocated Gaussian its source, of an added
            one its parent.
        fresh: `[N_new]` bool, True for clones, children, added and relocated Gaussians.
    """

    source: Tensor
    fresh: Tensor


def _check_tensor(field: str, values: Tensor, dtype: torch.dtype, length: int) -> None:
    if not isinstance(values, Tensor):
        raise GaussianError(
            f"{field} is a {type(values).__name__}, expected a torch tensor", field=field
        )
    if values.dtype != dtype or tuple(values.shape) != (length,):
        raise GaussianError(
            f"{field!r} is {values.dtype} {tuple(values.shape)}, expected {dtype} ({length},)",
            field=field,
        )


def _check_indices(field: str, indices: Tensor, count: int) -> None:
    outside = (indices < 0) | (indices >= count)
    _refuse(field, indices, outside, f"is not one of the {count:,} Gaussians")


def _refuse(field: str, indices: Tensor, wrong: Tensor, why: str) -> None:
    """Raise for the first index that is wrong."""
    if wrong.any():
        place = int(wrong.nonzero()[0])
        raise GaussianError(f"Gaussian {int(indices[place])} {why}", field=field, index=place)
