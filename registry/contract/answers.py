"""Checks of what components answer, before any of it reaches the Gaussians.

Each raises a `PluginError`; `blame` adds whose answer it was.
"""

from __future__ import annotations

import math
from typing import Any

from torch import Tensor

from core_rasterizer import Edit, GaussianError
from core_rasterizer.finite import undefined_places

from ..errors import PluginError
from .components import OpacityUpdate, Unavailable


def check_loss(loss: Any) -> Tensor:
    """A regularizer's term: one finite number."""
    tensor = _tensor("the loss", loss)
    if tensor.numel() != 1 or not tensor.is_floating_point():
        raise PluginError(
            f"the loss is {tensor.dtype} {tuple(tensor.shape)}, expected one floating-point number"
        )
    tensor = tensor.reshape(())
    _finite("the loss", tensor)
    return tensor


def check_opacity_scale(scale: Any, count: int) -> Tensor:
    """A modifier's factors: `[N]`, finite, at least 0."""
    tensor = _per_gaussian("the opacity scale", scale, count)
    if tensor.numel() and tensor.min() < 0:
        raise PluginError("the opacity scale has a negative value", where=_first(tensor < 0))
    return tensor


def check_opacity_update(update: Any, count: int) -> OpacityUpdate | None:
    """A policy's new opacities: `[N]`, in [0, 1]; or None."""
    if update is None:
        return None
    if not isinstance(update, OpacityUpdate):
        raise PluginError(f"the answer is a {type(update).__name__}, expected an OpacityUpdate")
    tensor = _per_gaussian("the opacity", update.opacities, count)
    if tensor.numel() and (tensor.min() < 0 or tensor.max() > 1):
        outside = (tensor < 0) | (tensor > 1)
        raise PluginError("an opacity is outside [0, 1]", where=_first(outside))
    return update


def check_edit(edit: Any, count: int) -> Edit | None:
    """A policy's edit, which must fit the Gaussians that there are (`Edit.check`); or None."""
    if edit is None:
        return None
    if not isinstance(edit, Edit):
        raise PluginError(f"the answer is a {type(edit).__name__}, expected an Edit")
    try:
        edit.check(count)
    except GaussianError as error:
        raise PluginError(error.what, where=f"Edit.{error.where}", fix=error.fix) from error
    return edit


def check_score(score: Any) -> float | Unavailable:
    """A metric's score: a number, perhaps infinite; or why there is none."""
    if isinstance(score, Unavailable):
        return score
    try:
        number = float(score)
    except (TypeError, ValueError) as error:
        raise PluginError(
            f"the score is a {type(score).__name__}, expected a number or Unavailable(reason)"
        ) from error
    if math.isnan(number):
        raise PluginError("the score is not a number")
    return number


def _per_gaussian(what: str, value: Any, count: int) -> Tensor:
    tensor = _tensor(what, value)
    if tuple(tensor.shape) != (count,) or not tensor.is_floating_point():
        raise PluginError(
            f"{what} is {tensor.dtype} {tuple(tensor.shape)}, expected floating point ({count},)"
        )
    _finite(what, tensor)
    return tensor


def _tensor(what: str, value: Any) -> Tensor:
    if not isinstance(value, Tensor):
        raise PluginError(f"{what} is a {type(value).__name__}, expected a torch tensor")
    return value


def _finite(what: str, tensor: Tensor) -> None:
    undefined = undefined_places(tensor)
    if len(undefined):
        where = f"Gaussian {int(undefined[0, 0])}" if tensor.ndim else ""
        raise PluginError(f"{what} is not finite", where=where)


def _first(bad: Tensor) -> str:
    return f"Gaussian {int(bad.nonzero()[0])}"
