"""Pipelines, described for people; scenes and components without a pipeline."""

from typing import TYPE_CHECKING

from core_rasterizer.first_use import names_on_first_use

if TYPE_CHECKING:
    from .pipeline_faults import capabilities, faults, needs
    from .scene_source import find_loader, load
else:
    __getattr__, __dir__ = names_on_first_use(__name__)

__all__ = [
    "capabilities",
    "faults",
    "find_loader",
    "load",
    "needs",
]
