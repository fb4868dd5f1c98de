"""Gaussians that training has driven to something that is no number."""

from __future__ import annotations

import torch
from torch import Tensor

from core_rasterizer import GaussianModel
from core_rasterizer.layout import PARAMETERS


def not_finite(model: GaussianModel) -> Tensor:
    """Which Gaussians have a parameter that is not finite, bool `[N]`."""
    finite = torch.ones(model.count, dtype=torch.bool)
    for name in PARAMETERS:
        finite &= torch.isfinite(model.read(name)).reshape(model.count, -1).all(dim=1)
    return ~finite
