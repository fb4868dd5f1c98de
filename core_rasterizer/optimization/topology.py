"""Clone, split and prune: one place where Gaussians come and go, with all that belongs to them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ..device import DeviceArray, Program
from ..errors import GaussianError
from ..layout import padded
from .adam import Adam
from .model import GaussianModel

CHILDREN = 2
"""How many Gaussians a split one becomes (3DGS)."""
SHRINK = 1.6
"""The children of a split are smaller than their parent by this factor (3DGS)."""

_GROUP = 64


@dataclass(frozen=True, eq=False)
class Edit:
    """What a policy wants: boolean masks `[N]` over the current Gaussians; None means none.

    Args:
        clone: add an exact copy.
        split: replace by two smaller ones, drawn from the Gaussian itself.
        prune: remove; wins over the other two.
    """

    clone: Tensor | None = None
    split: Tensor | None = None
    prune: Tensor | None = None


@dataclass(frozen=True, eq=False)
class Carried:
    """Where the Gaussians after an edit come from.

    Args:
        source: `[N_new]` int64, the index before the edit.
        fresh: `[N_new]` bool, True for clones and children.
    """

    source: Tensor
    fresh: Tensor


def apply_edit(
    model: GaussianModel, optimizer: Adam, edit: Edit, generator: torch.Generator
) -> Carried:
    """Carry out an edit on the parameters and the optimizer's moments.

    The Gaussians that stay keep their order; clones follow, then the children of splits. New ones
    start with zero moments, and gradients and densification statistics start anew for all.

    Args:
        generator: draws the children's offsets from N(0, covariance of the parent).

    Raises:
        GaussianError: a mask of a wrong shape or type, or an edit that leaves no Gaussian.
    """
    count = model.count
    clone, split, prune = (_mask(edit, name, count) for name in ("clone", "split", "prune"))
    clone &= ~prune
    split &= ~prune
    cloned, divided = clone.nonzero()[:, 0], split.nonzero()[:, 0]
    kept = (~(prune | split)).nonzero()[:, 0]
    source = torch.cat([kept, cloned, divided.repeat(CHILDREN)])
    fresh = torch.arange(len(source)) >= len(kept)
    if not len(source):
        raise GaussianError(
            f"the edit would remove all {count} Gaussians",
            field="prune",
            fix="keep at least one, or stop the policy that removes them",
        )
    mover = _Mover(model, source, fresh)
    optimizer.first_moments = mover.move(optimizer.first_moments, zero_fresh=True)
    optimizer.second_moments = mover.move(optimizer.second_moments, zero_fresh=True)
    parameters = mover.move(model.parameters, zero_fresh=False)
    children = CHILDREN * len(divided)
    if children:
        noise = torch.randn(children, 3, generator=generator, dtype=torch.float64)
        mover.spread(parameters, noise, first=len(source) - children)
    model.adopt(parameters, len(source))
    return Carried(source, fresh)


class _Mover:
    """Gathers columns of device arrays by one index list."""

    def __init__(self, model: GaussianModel, source: Tensor, fresh: Tensor) -> None:
        self._device, self._dtype = model.device, model.dtype
        self._program: Program = model.device.program(
            "raster/scene", "optimization/topology", dtype=model.dtype, TOPOLOGY_GROUP=_GROUP
        )
        self._count, self._capacity = len(source), padded(len(source))
        self._source = DeviceArray(model.device, (len(source),), torch.int32)
        self._source.write(source)
        self._fresh = DeviceArray(model.device, (len(source),), torch.int32)
        self._fresh.write(fresh)

    def move(self, values: DeviceArray, *, zero_fresh: bool) -> DeviceArray:
        target = DeviceArray(self._device, (values.shape[0], self._capacity), self._dtype)
        self._run(
            "gather_columns",
            self._capacity,
            values,
            self._source,
            self._fresh,
            target,
            np.uint32(self._count),
            np.uint32(values.shape[1]),
            np.uint32(self._capacity),
            np.uint32(values.shape[0]),
            np.uint32(zero_fresh),
        )
        return target

    def spread(self, parameters: DeviceArray, noise: Tensor, first: int) -> None:
        array = DeviceArray(self._device, tuple(noise.shape), self._dtype)
        array.write(noise)
        self._run(
            "spread_children",
            noise.shape[0],
            parameters,
            array,
            np.uint32(first),
            np.uint32(noise.shape[0]),
            np.uint32(self._capacity),
            (np.float64 if self._dtype == torch.float64 else np.float32)(SHRINK),
        )

    def _run(self, kernel: str, items: int, *arguments: DeviceArray | np.generic) -> None:
        size = -(-items // _GROUP) * _GROUP
        self._program.run(kernel, (size,), (_GROUP,), *arguments)
        self._device.finish()


def _mask(edit: Edit, name: str, count: int) -> Tensor:
    mask: Tensor | None = getattr(edit, name)
    if mask is None:
        return torch.zeros(count, dtype=torch.bool)
    if mask.dtype != torch.bool or tuple(mask.shape) != (count,):
        raise GaussianError(
            f"the mask is {mask.dtype} {tuple(mask.shape)}, expected torch.bool ({count},)",
            field=name,
        )
    return mask.clone()
