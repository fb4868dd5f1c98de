"""Errors of the host. Each says what happened, where, and how to mend it (`ExplainedError`).

ExplainedError
├── (the engine's errors, see core_rasterizer.errors)
├── PipelineError             the YAML file: unknown names, wrong types; carries file and line
├── PluginError               a plugin that cannot be loaded, or that failed while running
├── SceneError                photographs, poses or points that cannot be used
└── RunError                  the run folder: cannot be created, resumed or read
"""

from __future__ import annotations

from core_rasterizer.errors import ExplainedError

__all__ = ["PipelineError", "PluginError", "RunError", "SceneError"]


class PipelineError(ExplainedError):
    """The pipeline file is wrong; `where` names file and line."""


class PluginError(ExplainedError):
    """A plugin could not be loaded, or failed while running; `where` names it and the iteration."""


class SceneError(ExplainedError):
    """A scene could not be read, or what was read cannot be used."""


class RunError(ExplainedError):
    """A run folder could not be created, resumed or read."""
