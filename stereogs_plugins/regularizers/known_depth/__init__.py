"""Depth supervision of training views: `depth_from_initializer`, `depth_ranking`, `patch_depth`."""

from __future__ import annotations

from registry import Register, hookimpl

from .depth_from_initializer import DepthFromInitializer
from .depth_ranking import DepthRanking
from .patch_depth import PatchDepth

__all__ = ["DepthFromInitializer", "DepthRanking", "PatchDepth"]


@hookimpl
def stereogs_register_regularizers(
    register: Register[DepthFromInitializer | DepthRanking | PatchDepth],
) -> None:
    register("depth_from_initializer", DepthFromInitializer)
    register("depth_ranking", DepthRanking)
    register("patch_depth", PatchDepth)
