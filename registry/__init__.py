"""The host of StereoGS plugins: what a plugin author imports, and nothing else.

    import registry

    class Flat(registry.Initializer[registry.Settings]):
        ...

    @registry.hookimpl
    def stereogs_register_initializers(register):
        register("flat", Flat)

The host's own machinery lives in the modules: `registry.pipeline`, `registry.training_run`,
`registry.plugins`. A plugin is tried with `registry.testing`.
"""

from . import cache, image_fitting, photos, web_page
from .contract.component import Component, Context, ParameterGroup, Settings
from .contract.components import (
    Appearance,
    AverageErrorRole,
    Densification,
    Exporter,
    Initializer,
    Metric,
    Modifier,
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
from .contract.fact import Fact
from .contract.hook_points import API_VERSION
from .contract.hooks import Register, hookimpl
from .contract.maps import DepthMap, Disparity
from .contract.prior import Prior
from .contract.scene import PointCloud, Scene, TrainingScene, TrainingView, View, validate
from .contract.step import OtherField, Render, Sample, Step
from .drawing.metric_images import ImageMetricSettings, white_outside
from .drawing.pictures import grey, nearness_picture, side_by_side
from .errors import PipelineError, PluginError, RunError, SceneError
from .files import write_text
from .priors.capabilities import MonocularDepthPrior, MultiViewDepthPrior, StereoPrior
from .priors.learned_features import LearnedFeatures
from .priors.model_file import Sha256, read_model_file
from .priors.onnx_model import OnnxModel, OnnxTensor
from .priors.onnx_session import OnnxProvider, first_line
from .priors.onnx_settings import OnnxModelSettings

__all__ = [
    "API_VERSION",
    "Appearance",
    "AverageErrorRole",
    "Component",
    "Context",
    "Densification",
    "DepthMap",
    "Disparity",
    "Exporter",
    "Fact",
    "ImageMetricSettings",
    "Initializer",
    "LearnedFeatures",
    "Metric",
    "Modifier",
    "MonocularDepthPrior",
    "MultiViewDepthPrior",
    "OnnxModel",
    "OnnxModelSettings",
    "OnnxProvider",
    "OnnxTensor",
    "OpacityPolicy",
    "OpacityUpdate",
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
    "RunError",
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
    "TrainingView",
    "Unavailable",
    "View",
    "ViewMetric",
    "cache",
    "first_line",
    "grey",
    "hookimpl",
    "image_fitting",
    "nearness_picture",
    "photos",
    "read_model_file",
    "side_by_side",
    "validate",
    "web_page",
    "white_outside",
    "write_text",
]
