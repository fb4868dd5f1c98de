"""What every prior that runs an ONNX file lets a pipeline say."""

from __future__ import annotations

from pathlib import Path

from ..contract.component import Settings
from .model_file import Sha256
from .onnx_model import OnnxModel
from .onnx_session import OnnxProvider


class OnnxModelSettings(Settings):
    model: Path
    """The local ONNX file; weights belong inside it."""
    sha256: Sha256 | None = None
    """The hash that the file must have; null takes any file."""
    provider: OnnxProvider | None = None
    """What runs the model; null: the first of this list that is installed."""

    def open(self) -> OnnxModel:
        """The model, loaded."""
        return OnnxModel(self.model, self.sha256, self.provider)
