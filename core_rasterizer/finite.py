"""Search for values that are not finite."""

from __future__ import annotations

import math

import torch
from torch import Tensor


def undefined_places(values: Tensor) -> Tensor:
    """Return the indices `[K, values.ndim]` of NaNs and infinities, in order.

    Usually one pass: values are only searched if their sum is not finite.
    """
    values = values.detach()
    if math.isfinite(values.sum()):
        return torch.empty(0, values.ndim, dtype=torch.int64)
    return (~torch.isfinite(values)).nonzero()
