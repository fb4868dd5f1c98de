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
    from .contract.checks.scene import validate as validate
    from .contract.component import (
        Component as Component,
        Context as Context,
        GaussianFeature as GaussianFeature,
        ParameterGroup as ParameterGroup,
        Settings as Settings,
    )
    from .contract.components import (
        Appearance as Appearance,
        AverageErrorRole as AverageErrorRole,
        Densification as Densification,
        Exporter as Exporter,
        Initializer as Initializer,
        Metric as Metric,
        Modifier as Modifier,
        Observer as Observer,
        OpacityPolicy as OpacityPolicy,
        OpacityUpdate as OpacityUpdate,
        Perturbation as Perturbation,
        Regularizer as Regularizer,
        Report as Report,
        Sampler as Sampler,
        SceneLoader as SceneLoader,
        Unavailable as Unavailable,
        ViewMetric as ViewMetric,
    )
    from .contract.frame import Frame as Frame
    from .contract.hook_points import (
        API_VERSION as API_VERSION,
        Register as Register,
        hookimpl as hookimpl,
    )
    from .contract.host_defaults import HostDefaults as HostDefaults, Percent as Percent
    from .contract.prior import Prior as Prior
    from .contract.rendered import Rendered as Rendered
    from .contract.scene import (
        Fact as Fact,
        PointCloud as PointCloud,
        Scene as Scene,
        TrainingScene as TrainingScene,
        TrainingView as TrainingView,
        View as View,
    )
    from .contract.step import (
        OtherField as OtherField,
        Render as Render,
        Sample as Sample,
        Step as Step,
    )
    from .errors import PluginError as PluginError, RunError as RunError, SceneError as SceneError
else:
    __all__, __dir__, __getattr__ = names_on_first_use(__name__)
