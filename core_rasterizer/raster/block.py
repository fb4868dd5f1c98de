"""Gaussians as input of the kernels: one array of parameter rows."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..device import DeviceArray
from ..gaussians import Gaussians
from ..layout import PARAMETERS, rows_of


@dataclass(frozen=True)
class Block:
    """Gaussian parameters on a device: `[rows, capacity]`, see `layout`."""

    parameters: DeviceArray
    count: int
    activated: bool
    """If True, rows hold scales and opacities, not logarithms and logits."""

    @property
    def capacity(self) -> int:
        return self.parameters.shape[1]


def pack(gaussians: Gaussians, dtype: torch.dtype, capacity: int) -> Tensor:
    """Return parameters as rows `[rows, capacity]`, padded with zeros."""
    values = [getattr(gaussians, name) for name in PARAMETERS]
    rows = torch.cat([value[:, None].flatten(1).T for value in values])
    result = torch.zeros(rows.shape[0], capacity, dtype=dtype)
    result[:, : len(gaussians)] = rows.to(dtype)
    return result


def unpack(rows: Tensor, name: str, count: int) -> Tensor:
    """Return the rows of one parameter, `[width, capacity]`, in its public shape."""
    values = rows[:, :count]
    if name == "opacity_logits":
        return values[0]
    if name == "sh":
        return values.T.reshape(count, values.shape[0] // 3, 3)
    return values.T


def unpack_all(rows: Tensor, count: int, sh_degree: int) -> dict[str, Tensor]:
    """Return every parameter of an array `[rows, capacity]` by name, contiguous."""
    result = {}
    for name in PARAMETERS:
        first, last = rows_of(name, sh_degree)
        result[name] = unpack(rows[first:last], name, count).contiguous()
    return result
