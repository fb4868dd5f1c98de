"""Scenes and pipelines, described for people."""

from typing import TYPE_CHECKING

from core_rasterizer.first_use import names_on_first_use

if TYPE_CHECKING:
    from .pipeline_faults import capabilities, faults, needs
    from .scene_facts import image_sizes, points_in_view, warnings
    from .scene_source import find_loader, load, single_item
else:
    __getattr__, __dir__ = names_on_first_use(__name__)

__all__ = [
    "capabilities",
    "faults",
    "find_loader",
    "image_sizes",
    "load",
    "needs",
    "points_in_view",
    "single_item",
    "warnings",
]
