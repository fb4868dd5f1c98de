"""Where numbers are not finite."""

from __future__ import annotations

import math

import torch
from torch import Tensor


def undefined_places(values: Tensor) -> Tensor:
    """Indices `[K, values.ndim]` of NaNs and infinities, in order.

    Usually one pass: only a sum that is not finite is worth a closer look.
    """
    values = values.detach()
    if math.isfinite(values.sum()):
        return torch.empty(0, values.ndim, dtype=torch.int64)
    return (~torch.isfinite(values)).nonzero()
