"""Checks of what components answer, before any of it reaches the Gaussians.

Each raises a `PluginError`; `blame` adds whose answer it was.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from core_rasterizer import Edit, GaussianError
from core_rasterizer.finite import undefined_places

from ...errors import PluginError
from ..components import OpacityUpdate, Unavailable
from ..scene import TrainingView
from ..step import Sample


def check_loss(loss: Any) -> Tensor:
    """A regularizer's term: one finite number, which moves something unless it is 0."""
    tensor = _tensor("the loss", loss)
    if tensor.numel() != 1 or not tensor.is_floating_point():
        raise PluginError(
            f"the loss is {tensor.dtype} {tuple(tensor.shape)}, expected one floating-point number"
        )
    tensor = tensor.reshape(())
    _finite("the loss", tensor)
    if not tensor.requires_grad and float(tensor) != 0:
        raise PluginError(
            f"the loss is {float(tensor):g} and has no gradient: it would change nothing",
            fix="compute it from step.rendering, step.render(...) or step.parameter(...); "
            "step.model.read(...), .detach() and torch.no_grad() cut gradients off",
        )
    return tensor


def check_opacity_scale(scale: Any, count: int) -> Tensor:
    """A modifier's factors: `[N]`, finite, at least 0."""
    return _not_negative("the opacity scale", _per_gaussian("the opacity scale", scale, count))


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


def check_sample(sample: Any, count: int) -> Sample:
    """A sampler's answer: a target of the camera's size in [0, 1], and numbers that can be."""
    if not isinstance(sample, Sample):
        raise PluginError(f"the answer is a {type(sample).__name__}, expected a Sample")
    if not isinstance(sample.view, TrainingView):
        raise PluginError(f"the view is a {type(sample.view).__name__}, expected a TrainingView")
    target = _tensor("the target", sample.target)
    expected = (sample.camera.height, sample.camera.width, 3)
    if tuple(target.shape) != expected or target.dtype != torch.float32:
        raise PluginError(
            f"the target is {target.dtype} {tuple(target.shape)}, expected torch.float32 {expected}",
            fix="give the sample a camera of the target's size",
        )
    low, high = target.aminmax()  # one pass; a NaN becomes both and compares as false
    if not 0 <= low <= high <= 1:
        raise PluginError("the target has values outside [0, 1] or not finite")
    if not (math.isfinite(sample.sh_degree) and sample.sh_degree >= 0):
        raise PluginError(f"the SH degree is {sample.sh_degree}, expected 0 or more")
    if sample.smoothing is not None:
        _not_negative("the smoothing", _per_gaussian("the smoothing", sample.smoothing, count))
    return sample


def check_colors(colors: Any, shape: Sequence[int]) -> Tensor:
    """An appearance's colours: finite, of the render's shape."""
    tensor = _tensor("the image", colors)
    if tuple(tensor.shape) != tuple(shape) or not tensor.is_floating_point():
        raise PluginError(
            f"the image is {tensor.dtype} {tuple(tensor.shape)}, expected floating point {tuple(shape)}"
        )
    undefined = undefined_places(tensor.detach())
    if len(undefined):
        raise PluginError("the image is not finite", where=f"pixel {undefined[0].tolist()}")
    return tensor


def check_moves(moves: Any, groups: Collection[str]) -> Collection[str] | None:
    """The parameter groups that a term moves alone: known names, or None."""
    if moves is None:
        return None
    unknown = [name for name in moves if name not in groups]
    if isinstance(moves, str) or unknown:
        raise PluginError(
            f"`moves` names {unknown or moves!r}, which is no list of parameter groups",
            fix=f"use names from: {', '.join(groups)}",
        )
    return tuple(moves)


def check_offsets(offsets: Any, read: Callable[[str], Tensor]) -> Mapping[str, Tensor]:
    """A perturbation's answer: finite tensors in the shapes of the parameters that they name.

    Args:
        read: gives a parameter by its name.
    """
    if not isinstance(offsets, Mapping):
        raise PluginError(f"the answer is a {type(offsets).__name__}, expected a mapping by name")
    for name, offset in offsets.items():
        tensor, expected = _tensor(f"the offset of {name!r}", offset), tuple(read(name).shape)
        if tuple(tensor.shape) != expected or not tensor.is_floating_point():
            raise PluginError(
                f"the offset of {name!r} is {tensor.dtype} {tuple(tensor.shape)}, "
                f"expected floating point {expected}"
            )
        _finite(f"the offset of {name!r}", tensor)
    return offsets


def check_state(state: Any) -> Mapping[str, Tensor]:
    """A component's running state: tensors by name, which a file can hold."""
    if not isinstance(state, Mapping):
        raise PluginError(f"the state is a {type(state).__name__}, expected tensors by name")
    for name, value in state.items():
        if not isinstance(value, Tensor) or value.layout != torch.strided:
            raise PluginError(
                f"the state {name!r} is a {type(value).__name__}, which no checkpoint can hold",
                fix="keep it as a dense torch tensor",
            )
    return state


def check_carried(
    before: Mapping[str, Tensor], after: Mapping[str, Tensor], count: int, new_count: int
) -> None:
    """What a component keeps for each Gaussian must have followed a change of topology.

    Args:
        before, after: its state, before and after `carry`.
        count, new_count: how many Gaussians there were and are.
    """
    for name, value in after.items():
        earlier = before.get(name)
        per_gaussian = earlier is not None and earlier.ndim > 0 and len(earlier) == count
        if per_gaussian and (value.ndim == 0 or len(value) != new_count):
            raise PluginError(
                f"the state {name!r} has the shape {tuple(value.shape)} after an edit that made "
                f"{new_count} Gaussians of {count}",
                fix="implement carry(source, fresh): new Gaussian i comes from old Gaussian source[i]",
            )


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


def _not_negative(what: str, tensor: Tensor) -> Tensor:
    if tensor.numel() and tensor.min() < 0:
        raise PluginError(f"{what} has a negative value", where=_first(tensor < 0))
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
