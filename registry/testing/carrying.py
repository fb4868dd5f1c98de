"""Whether what a component keeps for each Gaussian follows the Gaussians."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ..contract.component import Component
from .judging import require


def check_carry(component: Component[Any], count: int) -> None:
    """Put made-up changes of topology to a component that has been at work.

    A tensor of `state()` with as many rows as there are Gaussians is taken for per-Gaussian state.

    Args:
        count: how many Gaussians the component has seen last.

    Raises:
        AssertionError: afterwards it has other than as many rows as there are Gaussians then, or one
            that stayed has another's row.
    """
    for kind, source, fresh in _changes(count):
        before = _per_gaussian(component, count)
        component.carry(source, fresh)
        after = component.state()
        for name, values in before.items():
            _check_rows(kind, name, values, after.get(name), source, fresh)
        count = len(source)


def _changes(count: int) -> list[tuple[str, Tensor, Tensor]]:
    """Kinds of edit as the host tells of them, one after the other: title, source, fresh."""
    steps = []
    for kind in ("cloned", "pruned and cloned", "relocated", "pruned"):
        old = torch.arange(count)
        if kind == "cloned":
            source, new = torch.cat([old, old[1::3]]), len(old[1::3])
        elif kind == "pruned and cloned":
            source, new = torch.cat([old[2:], old[-2:]]), 2
        elif kind == "relocated":
            source, new = torch.cat([old[-1:], old[1:]]), 0
        else:
            source, new = old[1::2], 0
        fresh = torch.zeros(len(source), dtype=torch.bool)
        fresh[len(source) - new :] = True
        fresh[0] |= kind == "relocated"
        steps.append((kind, source, fresh))
        count = len(source)
    return steps


def _per_gaussian(component: Component[Any], count: int) -> dict[str, Tensor]:
    state = component.state()
    return {
        name: values.clone()
        for name, values in state.items()
        if values.ndim and values.shape[0] == count
    }


def _check_rows(
    kind: str, name: str, before: Tensor, after: Tensor | None, source: Tensor, fresh: Tensor
) -> None:
    """Forgotten altogether, or one value for all, is a decision; another's row is a mistake."""
    if after is None or not len(after) or bool((after == after[:1]).all()):
        return
    require(
        len(after) == len(source),
        f"state()[{name!r}] has {len(after)} rows after Gaussians were {kind}, expected "
        f"{len(source)}; carry(source, fresh) must follow",
    )
    # What has been copied may share something with its copies; the others stay what they were.
    alone = ~fresh & (torch.bincount(source, minlength=len(before))[source] == 1)
    wrong = alone & (after != before[source]).reshape(len(source), -1).any(dim=1)
    require(
        not wrong.any(),
        f"state()[{name!r}] has another Gaussian's row at {int(wrong.int().argmax())} after "
        f"Gaussians were {kind}; new Gaussian i comes from old Gaussian source[i]",
    )
