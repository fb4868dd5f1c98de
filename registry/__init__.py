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
from .components import (
    Component,
    Context,
    Densification,
    Exporter,
    Initializer,
    Metric,
    Modifier,
    OpacityPolicy,
    OpacityUpdate,
    Prior,
    Regularizer,
    Report,
    SceneLoader,
    Settings,
    Step,
    Unavailable,
    ViewMetric,
)
from .errors import PipelineError, PluginError, RunError, SceneError
from .files import write_text
from .hook_points import API_VERSION
from .hooks import Register, hookimpl
from .learned_features import LearnedFeatures
from .metric_images import ImageMetricSettings, white_outside
from .model_file import Sha256, read_model_file
from .onnx_model import OnnxModel, OnnxTensor
from .onnx_session import OnnxProvider, first_line
from .onnx_settings import OnnxModelSettings
from .pictures import grey, nearness_picture, side_by_side
from .priors import (
    DepthMap,
    Disparity,
    MonocularDepthPrior,
    MultiViewDepthPrior,
    StereoPrior,
)
from .scene import PointCloud, Scene, View, validate

__all__ = [
    "API_VERSION",
    "Component",
    "Context",
    "Densification",
    "DepthMap",
    "Disparity",
    "Exporter",
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
    "PipelineError",
    "PluginError",
    "PointCloud",
    "Prior",
    "Register",
    "Regularizer",
    "Report",
    "RunError",
    "Scene",
    "SceneError",
    "SceneLoader",
    "Settings",
    "Sha256",
    "Step",
    "StereoPrior",
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
