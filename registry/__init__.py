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

from typing import TYPE_CHECKING, Any

from core_rasterizer.first_use import names_on_first_use

if TYPE_CHECKING:
    from .contract.checks.scene import validate
    from .contract.command import Command, TrainOption
    from .contract.component import Component, Context, ParameterGroup, Settings
    from .contract.components import (
        Appearance,
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
    from .contract.prior import Prior
    from .contract.scene import Fact, PointCloud, Scene, TrainingScene, TrainingView, View
    from .contract.step import OtherField, Render, Sample, Step
    from .errors import PluginError, RunError, SceneError
else:
    _get, __dir__ = names_on_first_use(__name__)

    def __getattr__(name: str) -> Any:
        """Return a name of the contract, or, with a warning, one that moved since version 0.1.0."""
        home = next((module for module, moved in _MOVED.items() if name in moved.split()), None)
        if home is None:
            return _get(name)
        import pkgutil
        import warnings

        warnings.warn(
            f"registry.{name} has moved: import it from {home}", DeprecationWarning, stacklevel=2
        )
        return pkgutil.resolve_name(f"{home}.{name}")


_MOVED = {
    "registry.events": "RunEnded RunStarted",
    "registry.priors": "MonocularDepthPrior MultiViewDepthPrior",
    "registry.runs": "read_results trained_gaussians",
    "registry.system": "write_text",
    "registry.toolkit": "cache optional_module web_page",
    "registry.toolkit.drawing": "LoggerSettings ViewPictures depth_ends",
    "registry.toolkit.networks": "OnnxModelSettings image_fitting",
    "registry.toolkit.views": "ViewParameters epipolar_distances triangulation virtual_views",
}
"""Names that example packages or the documentation of version 0.1.0 used, by their modules now."""

__all__ = [
    "API_VERSION",
    "Appearance",
    "Command",
    "Component",
    "Context",
    "Densification",
    "Exporter",
    "Fact",
    "Initializer",
    "Metric",
    "Modifier",
    "Observer",
    "OpacityPolicy",
    "OpacityUpdate",
    "OtherField",
    "ParameterGroup",
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
    "TrainOption",
    "TrainingScene",
    "TrainingView",
    "Unavailable",
    "View",
    "ViewMetric",
    "hookimpl",
    "validate",
]
