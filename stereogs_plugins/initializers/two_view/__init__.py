"""Points from pairs of photographs with known cameras: `flow_epipolar` and `matched_points`."""

from __future__ import annotations

from registry import Register, hookimpl

from .flow_epipolar import FlowEpipolar
from .matched_points import MatchedPoints

__all__ = ["FlowEpipolar", "MatchedPoints"]


@hookimpl
def stereogs_register_initializers(register: Register[FlowEpipolar | MatchedPoints]) -> None:
    register("flow_epipolar", FlowEpipolar)
    register("matched_points", MatchedPoints)
