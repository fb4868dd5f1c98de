"""What a stereo network's ONNX file may be, as far as its names and sizes tell."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, get_args

from registry.toolkit.networks.image_fitting import ValueRange

from .families import FAMILIES

if TYPE_CHECKING:
    from registry.toolkit.networks import OnnxModel, OnnxTensor

    from .families import StereoFamily

Guess = dict[str, Any]


def guesses(model: OnnxModel) -> list[Guess]:
    """Settings to try, without the file's own; empty if the graph takes no pair of images."""
    stacked = len(model.inputs) == 1 and _is_images(model.inputs[0], channels=(2, 6))
    apart = len(model.inputs) == 2 and all(_is_images(spec, channels=(3,)) for spec in model.inputs)
    if not (stacked or apart):
        return []
    for name, family in FAMILIES.items():
        if family.output is not None and _is_of(model, family):
            return [{"family": name}]
    kind: Guess = {"family": "hitnet" if stacked else "generic"}
    maps = [{"output": spec.name} for spec in model.outputs if _is_map(spec)]
    outputs: list[Guess] = [{}] if len(model.outputs) == len(maps) == 1 else maps
    return [
        {**kind, **output, "value_range": value_range, **sign}
        for output in outputs
        for sign in ({}, {"negated": True})
        for value_range in get_args(ValueRange)
    ]


def _is_of(model: OnnxModel, family: StereoFamily) -> bool:
    """Whether the graph has all names that the family gives, and its size."""
    inputs = [spec.name for spec in model.inputs]
    outputs = [spec.name for spec in model.outputs if _is_map(spec)]
    named = all(name in inputs for name in (family.left, family.right) if name is not None)
    answers = all(name in outputs for name in (family.output, *family.confidences))
    sized = family.frozen in ((None, None), model.inputs[0].shape[2:])
    return named and answers and sized


def _is_images(spec: OnnxTensor, channels: tuple[int, ...]) -> bool:
    return len(spec.shape) == 4 and spec.shape[1] in channels


def _is_map(spec: OnnxTensor) -> bool:
    """One number a pixel: `[N, H, W]`, `[N, 1, H, W]` or `[N, H, W, 1]`."""
    several = len(spec.shape) == 4 and 1 not in (spec.shape[1], spec.shape[3])
    return len(spec.shape) in (3, 4) and not several
