"""Losses on virtual views: agreement of fields, smooth depth, and two kinds of warping."""

from __future__ import annotations

from registry import Register, hookimpl

from .cycle_filtered_warping import CycleFilteredWarping
from .depth_smoothness import DepthSmoothness
from .field_agreement import FieldAgreement
from .forward_warping import ForwardWarping

__all__ = ["CycleFilteredWarping", "DepthSmoothness", "FieldAgreement", "ForwardWarping"]


@hookimpl
def stereogs_register_regularizers(
    register: Register[CycleFilteredWarping | DepthSmoothness | FieldAgreement | ForwardWarping],
) -> None:
    register("cycle_filtered_warping", CycleFilteredWarping)
    register("depth_smoothness", DepthSmoothness)
    register("field_agreement", FieldAgreement)
    register("forward_warping", ForwardWarping)
