"""The plugin contract: base classes, the data they exchange, and the hooks that register them.

    import registry

    class Flat(registry.Initializer[registry.Settings]):
        ...

    @registry.hookimpl
    def stereogs_register_initializers(register):
        register("flat", Flat)

Importing this package is cheap: each name is imported on first use. Prior models derive from a class in
`registry.priors`; building blocks for plugins are in `registry.toolkit`; `registry.testing` checks a plugin;
`import stereogs` runs trainings from Python.
"""

from typing import TYPE_CHECKING

from core_rasterizer.first_use import names_on_first_use

if TYPE_CHECKING:
    from .contract.checks.scene import validate
    from .contract.component import Component, Context, ParameterGroup, Settings
    from .contract.components import (
        Appearance,
        AverageErrorRole,
        Densification,
        Exporter,
        Initializer,
        Metric,
        Modifier,
        Observer,
        OpacityPolicy,
        OpacityUpdate,
        Perturbation,
        Regularizer,
        Report,
        Sampler,
        SceneLoader,
        Unavailable,
        ViewMetric,
    )
    from .contract.hook_points import API_VERSION, Register, hookimpl
    from .contract.host_defaults import HostDefaults, Percent
    from .contract.prior import Prior
    from .contract.scene import Fact, PointCloud, Scene, TrainingScene, TrainingView, View
    from .contract.step import OtherField, Render, Sample, Step
    from .errors import PluginError, RunError, SceneError
else:
    __getattr__, __dir__ = names_on_first_use(__name__)

__all__ = [
    "API_VERSION",
    "Appearance",
    "AverageErrorRole",
    "Component",
    "Context",
    "Densification",
    "Exporter",
    "Fact",
    "HostDefaults",
    "Initializer",
    "Metric",
    "Modifier",
    "Observer",
    "OpacityPolicy",
    "OpacityUpdate",
    "OtherField",
    "ParameterGroup",
    "Percent",
    "Perturbation",
    "PluginError",
    "PointCloud",
    "Prior",
    "Register",
    "Regularizer",
    "Render",
    "Report",
    "RunError",
    "Sample",
    "Sampler",
    "Scene",
    "SceneError",
    "SceneLoader",
    "Settings",
    "Step",
    "TrainingScene",
    "TrainingView",
    "Unavailable",
    "View",
    "ViewMetric",
    "hookimpl",
    "validate",
]
