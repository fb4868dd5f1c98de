"""Neural networks in ONNX files: load by path and hash, check, run, and adapt image sizes.

    from registry.toolkit.networks import OnnxModel, OnnxModelSettings
    from registry.toolkit.networks.image_fitting import in_range, padded

    model = settings.open()                                   of OnnxModelSettings
    fit = padded((height, width), (None, None), multiple=32)
    batch = in_range(fit.apply(images), "imagenet")
    depth = fit.undo(model.run({"image": batch})["depth"])

`LearnedFeatures` and `KeypointNetworks` wrap two frequent kinds of networks.
"""

from typing import TYPE_CHECKING

from core_rasterizer.first_use import names_on_first_use

if TYPE_CHECKING:
    from .feature_networks import KeypointNetworks, Keypoints, LearnedFeatures
    from .model_file import Sha256, read_model_file
    from .onnx_model import OnnxModel, OnnxModelSettings, OnnxTensor, answers_within
    from .onnx_session import OnnxProvider, first_line
else:
    __getattr__, __dir__ = names_on_first_use(__name__)

__all__ = [
    "KeypointNetworks",
    "Keypoints",
    "LearnedFeatures",
    "OnnxModel",
    "OnnxModelSettings",
    "OnnxProvider",
    "OnnxTensor",
    "Sha256",
    "answers_within",
    "first_line",
    "read_model_file",
]
