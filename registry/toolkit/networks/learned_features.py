"""Matching features of a small network, in the form of the MC-CNN "fast" architecture.

Zbontar and LeCun, "Stereo Matching by Training a Convolutional Neural Network to Compare Image
Patches", JMLR 2016: the image is grey and standardized, and two pixels match as well as the dot
product of their unit feature vectors says.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...errors import PluginError
from ..drawing.pictures import grey
from .onnx_model import OnnxModel

if TYPE_CHECKING:
    from pathlib import Path

    from torch import Tensor

    from .onnx_session import OnnxProvider


class LearnedFeatures:
    """Unit feature vectors of every pixel of an image.

    Args:
        path: an ONNX model with one input `[N, 1, H, W]` of open size, a standardized grey image, and
            one output `[N, C, H, W]`.
        sha256: the hash that the file must have, or None.
        provider: what runs the model, or None: the first that is installed.

    Raises:
        PluginError: see `OnnxModel`; or a graph of another form.
    """

    def __init__(
        self, path: str | Path, sha256: str | None = None, provider: OnnxProvider | None = None
    ) -> None:
        self._model = OnnxModel(path, sha256, provider)
        self._input, self._output = self._model.input().name, self._model.output().name

    @staticmethod
    def recognizes(model: OnnxModel) -> bool:
        """Whether a model has the form of such features, as far as its sizes tell."""
        if len(model.inputs) != 1 or len(model.outputs) != 1:
            return False
        grey, features = model.inputs[0].shape, model.outputs[0].shape
        return len(grey) == len(features) == 4 and grey[1] == 1 and features[1] != 1

    @property
    def fingerprint(self) -> str:
        """What the features depend on beside the image."""
        return self._model.fingerprint

    def __call__(self, image: Tensor) -> Tensor:
        """Features `[C, H, W]` float32; their length over C is 1, or 0 where a pixel has none.

        Args:
            image: `[H, W, 3]` float32 in [0, 1].

        Raises:
            PluginError: the model answers another size, or values that are not finite.
        """
        import torch
        from torch.nn.functional import normalize

        network_input = standardized_grey(image)
        features = self._model.run({self._input: network_input[None, None]})[self._output]
        height, width = network_input.shape
        if features.ndim != 4 or features.shape[0] != 1 or features.shape[2:] != (height, width):
            raise PluginError(
                f"the features have the shape {list(features.shape)}, "
                f"expected [1, C, {height}, {width}]",
                where=str(self._model.path),
                fix="use a model that answers one vector for each pixel",
            )
        if not torch.isfinite(features).all():
            raise PluginError("a feature is not finite", where=str(self._model.path))
        return normalize(features[0], dim=0)


def standardized_grey(image: Tensor) -> Tensor:
    """The image in grey, `[H, W]`, with mean 0 and standard deviation 1; all 0 if it is flat."""
    levels = grey(image)
    # In float32 the grey of a flat image may differ in its last bit; that is no texture.
    return (levels - levels.mean()) / levels.std(correction=0).clamp(min=1e-6)
