"""Check a loss term in one kernel against torch."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import torch
from torch import Tensor

from core_rasterizer import Device, PixelTerm, Rendering, open_device
from core_rasterizer.device import Variant

from .assertions import require

_IMAGES = ("rgb", "depth", "alpha")


def check_term(
    term: PixelTerm,
    reference: Callable[..., Tensor],
    *,
    device: Device | None = None,
    **given: Rendering | Tensor | float | None,
) -> None:
    """Check that a term has the value and the gradients of a function in torch, and repeats its bits.

    It runs in double precision, with the kernels of a CPU (not on a GPU) and those of a GPU. Gradients are
    also compared with finite differences. Give small random images, so that no pixel is near a kink.

    Args:
        reference: takes `given`, and returns the same loss in torch with autograd.
        device: must support double precision; None chooses (`open_device`).
        given: inputs of the term.

    Raises:
        AssertionError: they differ by more than 1e-7 of their size, or two calls differ.
    """
    device = device or open_device()
    names, leaves = list(term.gradients), list[Tensor]()
    for name in names:
        leaves.append(_find(given, name).detach().double().requires_grad_())

    def on(device: Device | None) -> Callable[..., Tensor]:
        def loss(*images: Tensor) -> Tensor:
            replaced = _replaced(given, dict(zip(names, images, strict=True)))
            return reference(**replaced) if device is None else term(device=device, **replaced)

        return loss

    expected = _result(on(None), leaves)
    for kind in kinds_of(device):
        ours = on(with_kernels(device, kind))
        first, again = _result(ours, leaves), _result(ours, leaves)
        for title, value, repeated, wanted in zip(
            ("loss", *(f"gradient of {name}" for name in names)),
            first,
            again,
            expected,
            strict=True,
        ):
            where = f"the {title} of the term, with the kernels of a {kind.upper()}, "
            require(torch.equal(value, repeated), f"{where}has other bits in a second call")
            close = torch.allclose(value, wanted, rtol=1e-7, atol=1e-7 * float(wanted.abs().max()))
            most = float((value - wanted).abs().max())
            require(close, f"{where}differs from the reference by up to {most:g}")
        torch.autograd.gradcheck(ours, leaves, fast_mode=True, atol=1e-6)


def kinds_of(device: Device) -> tuple[Variant, ...]:
    """Kinds of kernels that the device runs in a reasonable time."""
    return ("cpu", "gpu") if device.kind == "cpu" else ("gpu",)


@cache
def with_kernels(device: Device, kind: Variant) -> Device:
    """The device with these kernels, which are built once."""
    return device.as_variant(kind)


def _result(loss: Callable[..., Tensor], leaves: list[Tensor]) -> list[Tensor]:
    """The value and the gradients, zero where there is none."""
    value = loss(*leaves)
    found: Any = torch.autograd.grad(value, leaves, allow_unused=True)
    gradients = [
        torch.zeros_like(leaf) if gradient is None else gradient
        for gradient, leaf in zip(found, leaves, strict=True)
    ]
    return [value.detach().double(), *gradients]


def _find(given: dict[str, Any], name: str) -> Tensor:
    """The image of this name: an input, or the image of a rendering."""
    of, _, image = name.rpartition("_")
    found: Tensor = given[name] if name in given else getattr(given[of], image)
    return found


def _replaced(given: dict[str, Any], images: dict[str, Tensor]) -> dict[str, Any]:
    """The inputs in double precision, with other images by name."""

    def double(name: str, value: Tensor) -> Tensor:
        value = images.get(name, value.detach())
        return value.double() if value.is_floating_point() else value

    def of(name: str, value: Any) -> Any:
        if isinstance(value, Rendering):
            rgb, depth, alpha = (double(f"{name}_{i}", getattr(value, i)) for i in _IMAGES)
            return Rendering(rgb, depth, alpha)
        return double(name, value) if isinstance(value, Tensor) else value

    return {name: of(name, value) for name, value in given.items()}
