"""Neural networks in ONNX files: opened by path and hash, checked, and run."""

from typing import TYPE_CHECKING

from core_rasterizer.first_use import names_on_first_use

if TYPE_CHECKING:
    from .keypoint_networks import KeypointNetworks, Keypoints
    from .learned_features import LearnedFeatures
    from .model_file import Sha256, read_model_file
    from .onnx_model import OnnxModel, OnnxTensor
    from .onnx_session import OnnxProvider, first_line
    from .onnx_settings import OnnxModelSettings
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
    "first_line",
    "read_model_file",
]
