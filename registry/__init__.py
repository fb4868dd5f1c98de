"""The host of StereoGS plugins: what a plugin author imports, and nothing else.

    import registry

    class Flat(registry.Initializer[registry.Settings]):
        ...

    @registry.hookimpl
    def stereogs_register_initializers(register):
        register("flat", Flat)

Importing it costs nothing: each name is imported when it is first used. The host's own machinery lives
in the folders beside this file; `import stereogs` gives it to programs. A plugin is tried with
`registry.testing`.
"""

from typing import TYPE_CHECKING

from core_rasterizer.first_use import names_on_first_use

if TYPE_CHECKING:
    from . import cache, image_fitting, photos, triangulation, virtual_views, web_page
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
        Runner,
        RunningTask,
        Sampler,
        SceneLoader,
        TrainingTask,
        Unavailable,
        ViewMetric,
    )
    from .contract.events import IterationDone, RunEnded, RunStarted, ViewsScored
    from .contract.fact import Fact
    from .contract.hook_points import API_VERSION
    from .contract.hooks import Register, hookimpl
    from .contract.maps import DepthMap, Disparity, Flow, Matches
    from .contract.prior import Prior
    from .contract.scene import (
        SOLID,
        PointCloud,
        Scene,
        TrainingScene,
        TrainingView,
        View,
    )
    from .contract.step import OtherField, Render, Sample, Step
    from .drawing.camera_path import smooth_path
    from .drawing.logged_pictures import LoggerSettings
    from .drawing.metric_images import ImageMetricSettings, white_outside
    from .drawing.orientation import upright_rotation
    from .drawing.pictures import (
        RAMP,
        ViewPictures,
        depth_ends,
        grey,
        nearness_picture,
        ramp_picture,
        save_png,
        side_by_side,
    )
    from .drawing.video import write_video
    from .errors import PipelineError, PluginError, RunError, SceneError
    from .plugins.optional import optional_module
    from .priors.capabilities import (
        MatchingPrior,
        MonocularDepthPrior,
        MultiViewDepthPrior,
        OpticalFlowPrior,
        StereoPrior,
    )
    from .priors.epipolar import epipolar_distances
    from .priors.flow_geometry import flow_cycle_error, flow_in_size
    from .priors.keypoint_networks import KeypointNetworks, Keypoints
    from .priors.learned_features import LearnedFeatures
    from .priors.model_file import Sha256, read_model_file
    from .priors.onnx_model import OnnxModel, OnnxTensor
    from .priors.onnx_session import OnnxProvider, first_line
    from .priors.onnx_settings import OnnxModelSettings
    from .runs.results_file import read_results
    from .system.files import write_text
    from .training.checkpoint import trained_gaussians
    from .view_parameters import ViewParameters
else:
    __getattr__, __dir__ = names_on_first_use(__name__)

__all__ = [
    "API_VERSION",
    "RAMP",
    "SOLID",
    "Appearance",
    "AverageErrorRole",
    "Component",
    "Context",
    "Densification",
    "DepthMap",
    "Disparity",
    "Exporter",
    "Fact",
    "Flow",
    "ImageMetricSettings",
    "Initializer",
    "IterationDone",
    "KeypointNetworks",
    "Keypoints",
    "LearnedFeatures",
    "LoggerSettings",
    "Matches",
    "MatchingPrior",
    "Metric",
    "Modifier",
    "MonocularDepthPrior",
    "MultiViewDepthPrior",
    "Observer",
    "OnnxModel",
    "OnnxModelSettings",
    "OnnxProvider",
    "OnnxTensor",
    "OpacityPolicy",
    "OpacityUpdate",
    "OpticalFlowPrior",
    "OtherField",
    "ParameterGroup",
    "Perturbation",
    "PipelineError",
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
    "Sha256",
    "Step",
    "StereoPrior",
    "TrainingScene",
    "TrainingTask",
    "TrainingView",
    "Unavailable",
    "View",
    "ViewMetric",
    "ViewParameters",
    "ViewPictures",
    "ViewsScored",
    "cache",
    "depth_ends",
    "epipolar_distances",
    "first_line",
    "flow_cycle_error",
    "flow_in_size",
    "grey",
    "hookimpl",
    "image_fitting",
    "nearness_picture",
    "optional_module",
    "photos",
    "ramp_picture",
    "read_model_file",
    "read_results",
    "save_png",
    "side_by_side",
    "smooth_path",
    "trained_gaussians",
    "triangulation",
    "upright_rotation",
    "validate",
    "virtual_views",
    "web_page",
    "white_outside",
    "write_text",
    "write_video",
]
