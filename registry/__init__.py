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
    from . import web_page
    from .contract.component import Component, Context, Settings
    from .contract.components import (
        Densification,
        Exporter,
        Initializer,
        Metric,
        Modifier,
        OpacityPolicy,
        OpacityUpdate,
        Regularizer,
        Report,
        SceneLoader,
        Unavailable,
        ViewMetric,
    )
    from .contract.hook_points import API_VERSION
    from .contract.hooks import Register, hookimpl
    from .contract.prior import Prior
    from .contract.scene import PointCloud, Scene, View, validate
    from .contract.step import Step
    from .drawing.pictures import grey, nearness_picture, side_by_side
    from .errors import PipelineError, PluginError, RunError, SceneError
    from .priors.capabilities import (
        DepthMap,
        Disparity,
        MonocularDepthPrior,
        MultiViewDepthPrior,
        StereoPrior,
    )
    from .priors.model_file import Sha256, read_model_file
    from .priors.onnx_model import OnnxModel, OnnxTensor
    from .priors.onnx_session import OnnxProvider
    from .priors.prior_cache import cache_folder
else:
    __getattr__, __dir__ = names_on_first_use(__name__)

__all__ = [
    "API_VERSION",
    "Component",
    "Context",
    "Densification",
    "DepthMap",
    "Disparity",
    "Exporter",
    "Initializer",
    "Metric",
    "Modifier",
    "MonocularDepthPrior",
    "MultiViewDepthPrior",
    "OnnxModel",
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
    "cache_folder",
    "grey",
    "hookimpl",
    "nearness_picture",
    "read_model_file",
    "side_by_side",
    "validate",
    "web_page",
]
