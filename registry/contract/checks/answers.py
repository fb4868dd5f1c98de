"""Checks of what components return, before it reaches the Gaussians.

Each takes the answer and what the method received, returns the checked answer, and raises a `PluginError`;
`registry.calls` adds the component that returned it. `HOOK_POINTS` says which check belongs to which method.
Nothing here imports torch before it is needed.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...errors import PluginError
from ...messages.visible_text import visible
from ..components import OpacityUpdate, Unavailable
from ..scene import TrainingView
from ..step import Sample

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Edit

    from ..step import Step


def check_loss(loss: Any, step: Step) -> Tensor:
    """Check a regularizer's term: one finite number, with a gradient unless it is 0."""
    tensor = _tensor("the loss", loss)
    if tensor.numel() != 1 or not tensor.is_floating_point():
        raise PluginError(
            f"the loss is {tensor.dtype} {tuple(tensor.shape)}, expected one floating-point number"
        )
    tensor = _floats("the loss", tensor.reshape(()), ())
    if not tensor.requires_grad and float(tensor) != 0:
        raise PluginError(
            f"the loss is {float(tensor):g} and has no gradient: it would change nothing",
            fix="compute it from step.rendering, step.render(...) or step.parameter(...); "
            "step.model.read(...), .detach() and torch.no_grad() cut gradients off",
        )
    return tensor


def check_opacity_scale(scale: Any, step: Step) -> Tensor:
    """Check a modifier's factors: `[N]`, finite, at least 0."""
    tensor = _floats("the opacity scale", scale, (step.model.count,))
    _refuse_outside(tensor, 0, math.inf, "the opacity scale has a negative value")
    return tensor


def check_opacity_update(update: Any, step: Step) -> OpacityUpdate | None:
    """Check a policy's new opacities: `[N]`, in [0, 1]; or None."""
    if update is None:
        return None
    checked: OpacityUpdate = _instance("the answer", update, OpacityUpdate, "an OpacityUpdate")
    _instance("reset_moments", checked.reset_moments, bool, "True or False")
    tensor = _floats("the opacity", checked.opacities, (step.model.count,))
    _refuse_outside(tensor, 0, 1, "an opacity is outside [0, 1]")
    return checked


def check_edit(edit: Any, step: Step) -> Edit | None:
    """Check a policy's edit, which must fit the Gaussians (`Edit.check`); or None."""
    from core_rasterizer import Edit, GaussianError

    if edit is None:
        return None
    checked: Edit = _instance("the answer", edit, Edit, "an Edit")
    try:
        checked.check(step.model.count)
    except GaussianError as error:
        raise PluginError(error.what, where=f"Edit.{error.where}", fix=error.fix) from error
    return checked


def check_sample(sample: Any, step: Step, given: Sample) -> Sample:
    """Check a sampler's answer: a target of the camera's size in [0, 1], and numbers in range."""
    import torch

    checked: Sample = _instance("the answer", sample, Sample, "a Sample")
    _instance("the view", checked.view, TrainingView, "a TrainingView")
    target = _tensor("the target", checked.target)
    expected = (checked.camera.height, checked.camera.width, 3)
    if tuple(target.shape) != expected or target.dtype != torch.float32:
        raise PluginError(
            f"the target is {target.dtype} {tuple(target.shape)}, expected torch.float32 {expected}",
            fix="give the sample a camera of the target's size",
        )
    # A photograph was checked with the scene, and is guarded like it.
    same_view = checked.view is given.view
    if not ((same_view and target is given.view.image) or _in_unit_range(target)):
        raise PluginError("the target has values outside [0, 1] or not finite")
    if checked.weights is not None:
        weights = _tensor("the weights", checked.weights)
        if weights.dtype != torch.float32 or weights.shape != target.shape[:2]:
            raise PluginError(
                f"the weights are {weights.dtype} {tuple(weights.shape)}, the target {expected}",
                fix="change the size of `Sample.weights` with the target's",
            )
        if not ((same_view and weights is given.view.weights) or _in_unit_range(weights)):
            raise PluginError("the weights have values outside [0, 1] or not finite")
    kept = checked.weights is given.weights
    if not same_view and kept and checked.weights is not checked.view.weights:
        raise PluginError(
            "the sample has another view, but the weights of the one before",
            fix="replace both: `weights=view.weights`",
        )
    numbers = [
        n if type(n) is float else float(_instance("the background", n, Real, "numbers"))
        for n in checked.background
    ]
    if len(numbers) != 3 or not all(0 <= number <= 1 for number in numbers):
        raise PluginError(f"the background is {numbers}, expected three numbers in [0, 1]")
    if not (math.isfinite(checked.sh_degree) and checked.sh_degree >= 0):
        raise PluginError(f"the SH degree is {checked.sh_degree}, expected 0 or more")
    if checked.smoothing is not None:
        smoothing = _floats("the smoothing", checked.smoothing, (step.model.count,))
        _refuse_outside(smoothing, 0, math.inf, "the smoothing has a negative value")
    return checked


def check_colors(colors: Any, step: Step, given: Tensor) -> Tensor:
    """Check an appearance's colours: finite, of the render's shape."""
    return _floats("the image", colors, given.shape, pixels=True)


def check_moves(moves: Any, groups: Collection[str]) -> Collection[str] | None:
    """Check the parameter groups that a term alone moves: known names, or None."""
    if moves is None:
        return None
    if isinstance(moves, str) or not set(moves) <= set(groups):
        raise PluginError(
            f"`moves` must be a list of parameter groups, not {moves!r}",
            fix=f"use names from: {', '.join(groups)}",
        )
    return tuple(moves)


def check_offsets(offsets: Any, step: Step) -> Mapping[str, Tensor]:
    """Check a perturbation's answer: finite tensors in the shapes of the named parameters."""
    checked: Mapping[str, Tensor] = _instance("the answer", offsets, Mapping, "a mapping by name")
    for name, offset in checked.items():
        _floats(f"the offset of {name!r}", offset, step.model.read(name).shape)
    return checked


def check_state(state: Any) -> Mapping[str, Tensor]:
    """Check a component's running state: tensors by name that a file can hold."""
    import torch

    checked: Mapping[str, Tensor] = _instance("the state", state, Mapping, "tensors by name")
    for name, value in checked.items():
        if not isinstance(value, torch.Tensor) or value.layout != torch.strided or value.is_meta:
            raise PluginError(
                f"the state {name!r} is a {type(value).__name__}, which no checkpoint can hold",
                fix="keep it as a dense torch tensor that has its numbers (not on the device meta)",
            )
    return checked


def check_carried(
    before: Mapping[str, Tensor], after: Mapping[str, Tensor], count: int, new_count: int
) -> None:
    """Check that a component's state per Gaussian followed a change of topology.

    Args:
        before, after: the state before and after `carry`.
        count, new_count: numbers of Gaussians before and after.
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


def check_score(score: Any, *given: Any) -> float | Unavailable:
    """Check a metric's score: a number, which may be infinite, or `Unavailable`."""
    if isinstance(score, Unavailable):
        _instance("the reason", score.reason, str, "a text")
        return score
    try:
        if isinstance(score, str | bool):
            raise TypeError
        number = float(score)
    except (TypeError, ValueError) as error:
        raise PluginError(
            f"the score is a {type(score).__name__}, expected a number or Unavailable(reason)"
        ) from error
    if math.isnan(number):
        raise PluginError("the score is not a number")
    return number


def check_files(files: Any, *given: Any) -> list[Path]:
    """Check the answer of an exporter or a report: paths of files that exist."""
    if not isinstance(files, list | tuple) or not all(isinstance(file, Path) for file in files):
        raise PluginError(f"the answer is {files!r}, expected a list of paths")
    if hidden := [file for file in files if visible(file.name) != file.name]:
        raise PluginError(f"it returned {str(hidden[0])!r}, which has control characters")
    missing = [file for file in files if not file.is_file()]
    if missing:
        raise PluginError(f"it returned {missing[0]}, but there is no such file")
    return list(files)


def check_gradient_path(answer: Tensor, leaves: Sequence[Tensor]) -> None:
    """Refuse an answer from which no gradient reaches any of the leaves.

    A single number without gradient passes: `check_loss` accepts one only if it is 0.
    """
    if not answer.requires_grad and answer.ndim == 0:
        return
    wanted = {id(leaf) for leaf in leaves}
    pending, seen = [answer.grad_fn], set[Any]()
    found = id(answer) in wanted
    while pending and not found:
        node = pending.pop()
        if node is not None and node not in seen:
            seen.add(node)
            found = id(getattr(node, "variable", None)) in wanted
            pending += [following for following, _ in node.next_functions]
    if not found:
        raise PluginError(
            "its answer has no gradient path to what is trained: it would change nothing",
            fix="compute it with torch from step.rendering, step.render(...) or step.parameter(...); "
            "numpy, float(...), .detach() and torch.no_grad() cut gradients off",
        )


def _tensor(what: str, value: Any) -> Tensor:
    from torch import Tensor

    tensor: Tensor = _instance(what, value, Tensor, "a torch tensor")
    return tensor


def _instance(what: str, value: Any, kind: type[Any], expected: str) -> Any:
    if not isinstance(value, kind):
        raise PluginError(f"{what} is a {type(value).__name__}, expected {expected}")
    return value


def _floats(what: str, value: Any, shape: Sequence[int], *, pixels: bool = False) -> Tensor:
    """Return a floating-point tensor of the given shape with finite values, or refuse the value."""
    from core_rasterizer.gaussians import undefined_places

    tensor = _tensor(what, value)
    expected = tuple(shape)
    if tuple(tensor.shape) != expected or not tensor.is_floating_point():
        raise PluginError(
            f"{what} is {tensor.dtype} {tuple(tensor.shape)}, expected floating point {expected}"
        )
    undefined = undefined_places(tensor)
    if len(undefined):
        first = undefined[0].tolist()
        gaussian = f"Gaussian {first[0]}" if first else ""
        raise PluginError(f"{what} is not finite", where=f"pixel {first}" if pixels else gaussian)
    return tensor


def _in_unit_range(values: Tensor) -> bool:
    low, high = map(float, values.aminmax())  # one pass; a NaN becomes both and compares as false
    return 0 <= low <= high <= 1


def _refuse_outside(values: Tensor, least: float, most: float, what: str) -> None:
    """Raise a `PluginError` at the first Gaussian whose value `[N]`, which is finite, is out of range."""
    if not values.numel():
        return
    low, high = map(float, values.detach().aminmax())  # a fifth of the time of comparing all values
    if low < least or high > most:
        outside = (values < least) | (values > most)
        raise PluginError(what, where=f"Gaussian {int(outside.nonzero()[0])}")
