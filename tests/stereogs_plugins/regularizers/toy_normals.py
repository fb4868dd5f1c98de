"""A prior of normals, as a plugin."""

from __future__ import annotations

import torch
from torch import Tensor

from registry import Register, Settings, hookimpl
from registry.priors import NormalPrior

SKY = 4
"""Rows of the image without normals, at its top."""


class Wall(NormalPrior[Settings]):
    """Everything faces the camera, but the upper rows are sky."""

    def estimate(self, image: Tensor) -> Tensor:
        normals = torch.zeros_like(image)
        normals[SKY - 1 :, :, 2] = -2
        normals[SKY - 1 : SKY] = torch.nan
        return normals


@hookimpl
def stereogs_register_priors(register: Register[Wall]) -> None:
    register("toy_normals", Wall)
