"""Matching features of a small network with the interface of the MC-CNN "fast" architecture.

Zbontar and LeCun, "Stereo Matching by Training a Convolutional Neural Network to Compare Image
Patches", JMLR 2016: the input is a standardized grey image; the similarity of two pixels is the dot
product of their unit feature vectors.
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
    """A function that returns a unit feature vector for each pixel of an image.

    Args:
        path: Path of an ONNX model with one input `[N, 1, H, W]` of dynamic size, a standardized grey
            image, and one output `[N, C, H, W]`.
        sha256, provider: See `OnnxModel`.

    Raises:
        PluginError: See `OnnxModel`; also if the graph has several inputs or outputs.
    """

    def __init__(
        self, path: str | Path, sha256: str | None = None, provider: OnnxProvider | None = None
    ) -> None:
        self._model = OnnxModel(path, sha256, provider)
        self._input, self._output = self._model.input().name, self._model.output().name

    @staticmethod
    def recognizes(model: OnnxModel) -> bool:
        """Return whether the shapes of a model's input and output match this class."""
        if len(model.inputs) != 1 or len(model.outputs) != 1:
            return False
        grey, features = model.inputs[0].shape, model.outputs[0].shape
        return len(grey) == len(features) == 4 and grey[1] == 1 and features[1] != 1

    @property
    def fingerprint(self) -> str:
        """See `OnnxModel.fingerprint`."""
        return self._model.fingerprint

    def __call__(self, image: Tensor) -> Tensor:
        """Return features `[C, H, W]` float32 with norm 1 over C, or 0 for a zero feature.

        Args:
            image: `[H, W, 3]` float32 in [0, 1].

        Raises:
            PluginError: The model returns another size or non-finite values.
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
                fix="use a model that returns one vector for each pixel",
            )
        if not torch.isfinite(features).all():
            raise PluginError("a feature is not finite", where=str(self._model.path))
        return normalize(features[0], dim=0)


def standardized_grey(image: Tensor) -> Tensor:
    """Return the image in grey, `[H, W]`, with mean 0 and standard deviation 1; all 0 for a flat image."""
    levels = grey(image)
    # In float32 the grey levels of a flat image may differ in the last bit.
    return (levels - levels.mean()) / levels.std(correction=0).clamp(min=1e-6)
