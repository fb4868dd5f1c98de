"""What a policy wants done to the set of Gaussians, and where those after it come from."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from ..errors import GaussianError
from ..gaussians import Gaussians


@dataclass(frozen=True, eq=False)
class Relocation:
    """Gaussians that are put to better use elsewhere (3DGS-MCMC: Kheradmand et al. 2024, section 4).

    Each target becomes a copy of its source. A source and its copies then share what the source was:
    their opacities and scales are those of the paper's equation 9, so that the picture stays nearly the
    same. The optimizer's moments of sources and targets start anew.

    Args:
        source: `[M]` int64, indices of the Gaussians to copy; one may occur several times.
        target: `[M]` int64, indices of the Gaussians to overwrite, the dead; each once.
    """

    source: Tensor
    target: Tensor


@dataclass(frozen=True, eq=False)
class Edit:
    """What a policy wants; masks are boolean `[N]` over the current Gaussians, None means none.

    Relocation comes first, and the masks then speak of the Gaussians as it leaves them.

    Args:
        clone: add an exact copy.
        split: replace by smaller ones, drawn from the Gaussian itself.
        prune: remove; wins over the other two.
        split_into: how many children a split one has, at least 2 (3DGS: 2).
        shrink: what the scales of children are divided by, positive. 3DGS: 1.6, which is 0.8 times
            the number of children.
        add: M Gaussians from elsewhere, with as many SH bands as the model.
        parents: `[M]` int64, required with `add`: the current Gaussian whose per-Gaussian state in
            plugins each added one takes over.
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
        """Whether nothing would change."""
        masks = (self.clone, self.split, self.prune)
        return (
            not any(mask is not None and bool(mask.any()) for mask in masks)
            and not (self.add is not None and len(self.add))
            and not (self.relocate is not None and len(self.relocate.target))
        )

    def mask(self, name: str, count: int) -> Tensor:
        """A mask of one's own, `[N]` bool: "clone", "split" or "prune"; pruned ones are not in others."""
        mask: Tensor | None = getattr(self, name)
        chosen = torch.zeros(count, dtype=torch.bool) if mask is None else mask.clone()
        return chosen if name == "prune" or self.prune is None else chosen & ~self.prune

    def check(self, count: int) -> None:
        """Refuse what cannot be done to so many Gaussians.

        Raises:
            GaussianError: naming the field, and the index where there is one.
        """
        for name in ("clone", "split", "prune"):
            mask = getattr(self, name)
            if mask is not None:
                _check_tensor(name, mask, torch.bool, count)
        if not isinstance(self.split_into, int) or self.split_into < 2:
            raise GaussianError(
                f"a split into {self.split_into} is asked for",
                field="split_into",
                fix="use a whole number of children, at least 2",
            )
        if not (math.isfinite(self.shrink) and self.shrink > 0):
            raise GaussianError(
                f"children are to shrink by {self.shrink}",
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
                _refuse(field, indices, self.prune[indices], "is to be pruned too")
        times = torch.bincount(move.target, minlength=count)
        _refuse("relocate.target", move.target, times[move.target] > 1, "is a target twice")
        copied = torch.zeros(count, dtype=torch.bool)
        copied[move.source] = True
        _refuse("relocate.target", move.target, copied[move.target], "is a source too")


@dataclass(frozen=True, eq=False)
class Carried:
    """Where the Gaussians after an edit come from.

    Args:
        source: `[N_new]` int64, the index before the edit; of a relocated Gaussian that of the one
            that it was copied from, of an added one its parent.
        fresh: `[N_new]` bool, True for clones, children, added ones and relocated ones.
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
    _refuse(field, indices, outside, f"is not among the {count:,} that there are")


def _refuse(field: str, indices: Tensor, wrong: Tensor, why: str) -> None:
    """Refuse the first Gaussian of a list of indices for which something is wrong."""
    if wrong.any():
        place = int(wrong.nonzero()[0])
        raise GaussianError(f"Gaussian {int(indices[place])} {why}", field=field, index=place)
