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
    from .feature_networks import (
        KeypointNetworks as KeypointNetworks,
        Keypoints as Keypoints,
        LearnedFeatures as LearnedFeatures,
    )
    from .model_file import (
        MODELS_VARIABLE as MODELS_VARIABLE,
        Sha256 as Sha256,
        model_files as model_files,
        read_model_file as read_model_file,
    )
    from .onnx_model import (
        OnnxModel as OnnxModel,
        OnnxModelSettings as OnnxModelSettings,
        OnnxTensor as OnnxTensor,
    )
    from .onnx_session import OnnxProvider as OnnxProvider, first_line as first_line
else:
    __all__, __dir__, __getattr__ = names_on_first_use(__name__)
