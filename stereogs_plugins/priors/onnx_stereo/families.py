"""Stereo networks: what each family's ONNX file is called inside, takes and answers.

Written from the families' own export scripts and model code. A file that was exported in another way
is fitted with the settings of the same names.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from registry.toolkit.networks.image_fitting import FrozenSize, ValueRange

FamilyName = Literal[
    "foundation_stereo",
    "fast_foundation_stereo",
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
        value_range: the numbers of black and white.
        multiple: both sides of an input must be a multiple of this where the graph leaves them open.
        negated: the output is the flow from left to right, which is minus the disparity.
        max_disparity: the largest that the network can see, in its own pixels; None: no limit.
        stacked: one input `[N, 2, H, W]` (grey) or `[N, 6, H, W]` (colour) takes the left image and
            behind it the right one; `left` and `right` do not count.
        frozen: the size to which all of its files are frozen, if they are to one.
        confidences: names of outputs shaped like the disparity, in [0, 1], 1 = to be trusted.
    """

    left: str | None = None
    right: str | None = None
    output: str | None = None
    value_range: ValueRange = "0..255"
    multiple: int = 32
    negated: bool = False
    max_disparity: float | None = None
    stacked: bool = False
    frozen: FrozenSize = (None, None)
    confidences: tuple[str, ...] = ()


FAMILIES: dict[FamilyName, StereoFamily] = {
    "foundation_stereo": StereoFamily("left", "right", "disp", max_disparity=416),
    "fast_foundation_stereo": StereoFamily("left", "right", "disp", max_disparity=192),
    "s2m2": StereoFamily(
        "input_left",
        "input_right",
        "output_disp",
        confidences=("output_occ", "output_conf"),
    ),
    "lite_any_stereo": StereoFamily(
        "left", "right", "disparity", max_disparity=192, frozen=(384, 1248)
    ),
    "raft_stereo": StereoFamily(output="flow_up", negated=True),
    "hitnet": StereoFamily(value_range="0..1", multiple=16, stacked=True),
    "generic": StereoFamily(),
}
