"""What authors of plugins import: base classes, the data that components exchange, and the hooks.

    from stereogs.api import Initializer, Register, Settings, hookimpl

    class Flat(Initializer[Settings]):
        ...

    @hookimpl
    def stereogs_register_initializers(register: Register[Flat]) -> None:
        register("flat", Flat)

All names of this module are stable: a release that breaks one increases `API_VERSION`, and the release
before it warns. `stereogs.testing`, `registry.runs`, `registry.toolkit` and the other names of
`core_rasterizer` may change with a note in the changelog. All other modules are internal.
"""

from typing import TYPE_CHECKING

from core_rasterizer.first_use import names_on_first_use

if TYPE_CHECKING:
    from core_rasterizer import (
        Camera as Camera,
        Device as Device,
        Edit as Edit,
        ExplainedError as ExplainedError,
        GaussianReader as GaussianReader,
        PixelTerm as PixelTerm,
        Rendering as Rendering,
    )
    from registry import (
        API_VERSION as API_VERSION,
        Appearance as Appearance,
        AverageErrorRole as AverageErrorRole,
        Component as Component,
        Context as Context,
        Densification as Densification,
        Exporter as Exporter,
        Fact as Fact,
        Frame as Frame,
        GaussianFeature as GaussianFeature,
        HostDefaults as HostDefaults,
        Initializer as Initializer,
        Metric as Metric,
        Modifier as Modifier,
        Observer as Observer,
        OpacityPolicy as OpacityPolicy,
        OpacityUpdate as OpacityUpdate,
        OtherField as OtherField,
        ParameterGroup as ParameterGroup,
        Percent as Percent,
        Perturbation as Perturbation,
        PluginError as PluginError,
        PointCloud as PointCloud,
        Prior as Prior,
        Register as Register,
        Regularizer as Regularizer,
        Render as Render,
        Rendered as Rendered,
        Report as Report,
        RunError as RunError,
        Sample as Sample,
        Sampler as Sampler,
        Scene as Scene,
        SceneError as SceneError,
        SceneLoader as SceneLoader,
        Settings as Settings,
        Step as Step,
        TrainingScene as TrainingScene,
        TrainingView as TrainingView,
        Unavailable as Unavailable,
        View as View,
        ViewMetric as ViewMetric,
        hookimpl as hookimpl,
        validate as validate,
    )
    from registry.confidence import (
        Confidence as Confidence,
        ConfidenceEstimator as ConfidenceEstimator,
        Trained as Trained,
    )
    from registry.events import (
        IterationDone as IterationDone,
        RunEnded as RunEnded,
        RunStarted as RunStarted,
        ViewsScored as ViewsScored,
    )
    from registry.priors import (
        DepthMap as DepthMap,
        Disparity as Disparity,
        Flow as Flow,
        GaussiansPrior as GaussiansPrior,
        MaskPrior as MaskPrior,
        Matches as Matches,
        MatchingPrior as MatchingPrior,
        MonocularDepth as MonocularDepth,
        MonocularDepthPrior as MonocularDepthPrior,
        MultiViewDepthPrior as MultiViewDepthPrior,
        NormalPrior as NormalPrior,
        OpticalFlowPrior as OpticalFlowPrior,
        PosedDepth as PosedDepth,
        PosedDepthPrior as PosedDepthPrior,
        StereoPrior as StereoPrior,
    )
    from registry.runners import (
        Runner as Runner,
        RunningTask as RunningTask,
        TrainingTask as TrainingTask,
    )
    from registry.runs.options import RunOptions as RunOptions
    from registry.runs.run import Run as Run

    from .command_line.arguments import add_run as add_run, open_given as open_given
    from .command_line.command import (
        Command as Command,
        TrainOption as TrainOption,
        TrainRequest as TrainRequest,
    )
    from .command_line.output import console as console
    from .session import open_run as open_run
else:
    __all__, __dir__, __getattr__ = names_on_first_use(__name__)
