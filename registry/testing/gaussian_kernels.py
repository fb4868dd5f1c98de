"""Checks of kernels over Gaussians, against the same numbers in torch."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import torch
from torch import Tensor

from core_rasterizer import Device, GaussianKernel, GaussianModel, GaussianReader, open_device

from ..pipeline.training_settings import TrainingSettings
from ..training.initial_model import initial_gaussians
from .assertions import require
from .pixel_terms import kinds_of, with_kernels
from .scenes import SMALL, points_of, scene_of

Reference = Callable[..., tuple[Mapping[str, Tensor], Mapping[str, Tensor | float]]]


def check_kernel(
    kernel: GaussianKernel,
    reference: Reference,
    *,
    count: int = SMALL.points,
    device: Device | None = None,
    **given: Tensor | float | None,
) -> None:
    """Check that a kernel returns what a function in torch returns, and the same bits in each call.

    It runs after a backward pass, with the kernels of a CPU (not on a GPU) and those of a GPU.

    Args:
        reference: takes a `GaussianReader` and `given`; returns outputs `[count]` and sums, as the kernel.
        count: number of Gaussians.
        device: None chooses (`open_device`).
        given: inputs of the kernel.

    Raises:
        AssertionError: numbers differ by more than 1e-4 of the largest, or two calls differ.
    """
    device = device or open_device()
    for kind in kinds_of(device):
        model = _trained(with_kernels(device, kind), count)
        first, again, wanted = (
            _numbers(*call(model, **given)) for call in (kernel, kernel, reference)
        )
        where = f"of the kernel, with the kernels of a {kind.upper()}, "
        require(
            first.keys() == wanted.keys(),
            f"the names {where}are {[*first]}, those of the reference {[*wanted]}",
        )
        for name, value in first.items():
            require(
                torch.equal(value, again[name]), f"{name} {where}has other bits in a second call"
            )
            most = float((value - wanted[name]).abs().max())
            close = most <= 1e-4 * float(wanted[name].abs().max())
            require(close, f"{name} {where}differs from the reference by up to {most:g}")


def _trained(device: Device, count: int) -> GaussianReader:
    """Gaussians with gradients of a render."""
    size = replace(SMALL, points=count)
    model = GaussianModel(initial_gaussians(points_of(size), TrainingSettings()), device)
    view = scene_of(size).train[0]
    (model.render(view.camera).rgb - view.image).square().sum().backward()
    return model.reader()


def _numbers(
    outputs: Mapping[str, Tensor], sums: Mapping[str, Tensor | float]
) -> dict[str, Tensor]:
    named = {**outputs, **{name: torch.as_tensor(value) for name, value in sums.items()}}
    return {name: value.detach().double().clone() for name, value in named.items()}
