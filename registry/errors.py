"""Errors of the host: `ExplainedError`s, as those of `core_rasterizer.errors`."""

from __future__ import annotations

from core_rasterizer.errors import ExplainedError

__all__ = ["PipelineError", "PluginError", "RunError", "SceneError"]


class PipelineError(ExplainedError):
    """The pipeline is invalid; `where` names file and line."""


class PluginError(ExplainedError):
    """A plugin could not be loaded, or failed while running; `where` names it and the iteration."""


class SceneError(ExplainedError):
    """Photographs, cameras or points could not be read or cannot be used."""


class RunError(ExplainedError):
    """A run folder could not be created, resumed or read."""
