"""Checks of estimates."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ..errors import PluginError

if TYPE_CHECKING:
    from torch import Tensor


def check_map(what: str, answer: Any, image: Tensor, *channels: int) -> None:
    """Refuse an estimate that is not a tensor of shape `[H, W, *channels]`.

    Raises:
        PluginError: It is not.
    """
    from torch import Tensor

    shape = (*image.shape[:2], *channels)
    if not isinstance(answer, Tensor) or tuple(answer.shape) != shape:
        got = tuple(answer.shape) if isinstance(answer, Tensor) else type(answer).__name__
        raise PluginError(f"the {what} is {got}, expected a tensor of shape {tuple(shape)}")


def check_finite(what: str, answer: Tensor) -> None:
    """Refuse an estimate with non-finite values.

    Raises:
        PluginError: A value is not finite.
    """
    import torch

    if not torch.isfinite(answer).all():
        raise PluginError(f"the {what} has values that are not finite")
