"""What authors of plugins import: base classes, the data that components exchange, and the hooks.

    from stereogs.api import Initializer, Register, Settings, hookimpl

    class Flat(Initializer[Settings]):
        ...

    @hookimpl
    def stereogs_register_initializers(register: Register[Flat]) -> None:
        register("flat", Flat)

All names of this module are stable: a release that breaks one increases `API_VERSION`, and the release
before it warns. `registry.toolkit`, `registry.testing` and `core_rasterizer` may change with a note in the
changelog. All other modules are internal.
"""

from typing import TYPE_CHECKING

from core_rasterizer.first_use import names_on_first_use

if TYPE_CHECKING:
    from registry import (
        API_VERSION,
        Appearance,
        AverageErrorRole,
        Component,
        Context,
        Densification,
        Exporter,
        Fact,
        HostDefaults,
        Initializer,
        Metric,
        Modifier,
        Observer,
        OpacityPolicy,
        OpacityUpdate,
        OtherField,
        ParameterGroup,
        Percent,
        Perturbation,
        PluginError,
        PointCloud,
        Prior,
        Register,
        Regularizer,
        Render,
        Report,
        RunError,
        Sample,
        Sampler,
        Scene,
        SceneError,
        SceneLoader,
        Settings,
        Step,
        TrainingScene,
        TrainingView,
        Unavailable,
        View,
        ViewMetric,
        hookimpl,
        validate,
    )
    from registry.confidence import Confidence, ConfidenceEstimator, Trained
    from registry.events import IterationDone, RunEnded, RunStarted, ViewsScored
    from registry.priors import (
        DepthMap,
        Disparity,
        Flow,
        Matches,
        MatchingPrior,
        MonocularDepthPrior,
        MultiViewDepthPrior,
        OpticalFlowPrior,
        StereoPrior,
    )
    from registry.runners import Runner, RunningTask, TrainingTask

    from .command_line.command import Command, TrainOption, TrainRequest
else:
    __getattr__, __dir__ = names_on_first_use(__name__)

__all__ = [
    "API_VERSION",
    "Appearance",
    "AverageErrorRole",
    "Command",
    "Component",
    "Confidence",
    "ConfidenceEstimator",
    "Context",
    "Densification",
    "DepthMap",
    "Disparity",
    "Exporter",
    "Fact",
    "Flow",
    "HostDefaults",
    "Initializer",
    "IterationDone",
    "Matches",
    "MatchingPrior",
    "Metric",
    "Modifier",
    "MonocularDepthPrior",
    "MultiViewDepthPrior",
    "Observer",
    "OpacityPolicy",
    "OpacityUpdate",
    "OpticalFlowPrior",
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
    "RunEnded",
    "RunError",
    "RunStarted",
    "Runner",
    "RunningTask",
    "Sample",
    "Sampler",
    "Scene",
    "SceneError",
    "SceneLoader",
    "Settings",
    "Step",
    "StereoPrior",
    "TrainOption",
    "TrainRequest",
    "Trained",
    "TrainingScene",
    "TrainingTask",
    "TrainingView",
    "Unavailable",
    "View",
    "ViewMetric",
    "ViewsScored",
    "hookimpl",
    "validate",
]
