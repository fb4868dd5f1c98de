"""One parameter of a device-resident model as a torch tensor in autograd, plain or activated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

if TYPE_CHECKING:
    from .model import GaussianModel


@dataclass(frozen=True)
class Activation:
    """How a parameter that is optimized becomes the quantity that is meant.

    Args:
        stored: the parameter's name.
        activate: from what is stored to what is meant.
        slope: the derivative of `activate` at what is stored.
    """

    stored: str
    activate: Callable[[Tensor], Tensor]
    slope: Callable[[Tensor], Tensor]


ACTIVATED = {
    "opacities": Activation(
        # Without the cancellation of 1 - sigmoid(x) where a Gaussian is nearly opaque.
        "opacity_logits",
        torch.sigmoid,
        lambda x: torch.sigmoid(x) * torch.sigmoid(-x),
    ),
    "scales": Activation("log_scales", torch.exp, torch.exp),
}
"""Activated quantities by name."""


def stored_name(name: str) -> str:
    """The parameter behind the name of a parameter or of an activated quantity."""
    return ACTIVATED[name].stored if name in ACTIVATED else name


def values_in_autograd(model: GaussianModel, anchor: Tensor, name: str) -> Tensor:
    """`GaussianModel.parameter`; the anchor makes torch call `backward`."""
    values: Tensor = _Parameter.apply(anchor, model, name)
    return values


class _Parameter(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, anchor: Tensor, model: GaussianModel, name: str) -> Tensor:
        ctx.model, ctx.name, ctx.parameters = model, name, model.parameters
        # Where memory is shared, what is read changes with the model.
        stored = model.read(stored_name(name)).clone()
        if name not in ACTIVATED:
            return stored
        ctx.save_for_backward(stored)
        return ACTIVATED[name].activate(stored)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[None, None, None]:
        ctx.model.check_unedited(ctx.parameters)
        if ctx.name in ACTIVATED:
            (stored,) = ctx.saved_tensors
            gradient = gradient * ACTIVATED[ctx.name].slope(stored)
        ctx.model.add_gradient(ctx.name, gradient)
        return None, None, None
