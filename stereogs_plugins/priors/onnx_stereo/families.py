"""Stereo networks: names and formats of each family's inputs and outputs, and recognition of files.

Taken from the families' export scripts and model code. Settings of the same names adapt files that were
exported differently.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

from registry.toolkit.networks.image_fitting import ValueRange

if TYPE_CHECKING:
    from registry.toolkit.networks import OnnxModel, OnnxTensor
    from registry.toolkit.networks.image_fitting import FrozenShape

FamilyName = Literal[
    "foundation_stereo",
    "fast_foundation_stereo",
    "c_fast_foundation_stereo",
    "s2m2",
    "lite_any_stereo",
    "raft_stereo",
    "hitnet",
    "generic",
]


@dataclass(frozen=True)
class StereoFamily:
    """One family.

    Args:
        left, right: names of the inputs `[N, 3, H, W]`; None: the graph's first and second.
        output: name of the disparity `[N, 1, H, W]`, `[N, H, W, 1]` or `[N, H, W]`; None: the only output.
        value_range: range of pixel values, from black to white.
        multiple: both sides of an input must be a multiple of this if the graph's size is dynamic.
        negated: the output is the flow from left to right, which is minus the disparity.
        max_disparity: largest disparity of the network, in its own pixels; None: no limit.
        stacked: one input `[N, 2, H, W]` (grey) or `[N, 6, H, W]` (colour) takes the left image followed
            by the right one; `left` and `right` are ignored.
        frozen: fixed size of all of its files, if any.
        confidences: names of outputs shaped like the disparity, in [0, 1], 1 = reliable.
        published: the network and the address of its weights.
    """

    left: str | None = None
    right: str | None = None
    output: str | None = None
    value_range: ValueRange = "0..255"
    multiple: int = 32
    negated: bool = False
    max_disparity: float | None = None
    stacked: bool = False
    frozen: FrozenShape = (None, None)
    confidences: tuple[str, ...] = ()
    published: str = ""


FAMILIES: dict[FamilyName, StereoFamily] = {
    "foundation_stereo": StereoFamily(
        "left",
        "right",
        "disp",
        max_disparity=416,
        published="FoundationStereo (https://github.com/NVlabs/FoundationStereo)",
    ),
    "fast_foundation_stereo": StereoFamily(
        "left",
        "right",
        "disp",
        max_disparity=192,
        published="Fast-FoundationStereo (https://github.com/NVlabs/Fast-FoundationStereo)",
    ),
    "c_fast_foundation_stereo": StereoFamily(
        "left_image",
        "right_image",
        "disparity",
        value_range="imagenet",
        published="C-Fast-FoundationStereo, one ONNX file",
    ),
    "s2m2": StereoFamily(
        "input_left",
        "input_right",
        "output_disp",
        confidences=("output_occ", "output_conf"),
        published="S2M2 (https://github.com/junhong-3dv/s2m2)",
    ),
    "lite_any_stereo": StereoFamily(
        "left",
        "right",
        "disparity",
        max_disparity=192,
        frozen=(384, 1248),
        published="Lite Any Stereo (https://github.com/TomTomTommi/LiteAnyStereo)",
    ),
    "raft_stereo": StereoFamily(
        output="flow_up",
        negated=True,
        published="RAFT-Stereo (https://github.com/princeton-vl/RAFT-Stereo)",
    ),
    "hitnet": StereoFamily(
        value_range="0..1",
        multiple=16,
        stacked=True,
        published="HITNet (https://github.com/google-research/google-research/tree/master/hitnet)",
    ),
    "generic": StereoFamily(),
}

Guess = dict[str, Any]


def guesses(model: OnnxModel) -> list[Guess]:
    """Settings to try, without `model`; empty if the graph does not take a pair of images."""
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
    """True if the graph has all names of the family, and its size."""
    inputs = [spec.name for spec in model.inputs]
    outputs = [spec.name for spec in model.outputs if _is_map(spec)]
    named = all(name in inputs for name in (family.left, family.right) if name is not None)
    answers = all(name in outputs for name in (family.output, *family.confidences))
    sized = family.frozen in ((None, None), model.inputs[0].shape[2:])
    return named and answers and sized


def _is_images(spec: OnnxTensor, channels: tuple[int, ...]) -> bool:
    return len(spec.shape) == 4 and spec.shape[1] in channels


def _is_map(spec: OnnxTensor) -> bool:
    """True for one number per pixel: `[N, H, W]`, `[N, 1, H, W]` or `[N, H, W, 1]`."""
    several = len(spec.shape) == 4 and 1 not in (spec.shape[1], spec.shape[3])
    return len(spec.shape) in (3, 4) and not several
