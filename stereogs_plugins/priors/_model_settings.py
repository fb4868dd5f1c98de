"""What every prior that runs an ONNX file lets a pipeline say."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field

from registry import OnnxModel, OnnxProvider, Settings


class ModelSettings(Settings):
    model: Path
    """The local ONNX file; weights belong inside it."""
    sha256: str | None = Field(None, pattern="^[0-9a-fA-F]{64}$")
    """The hash that the file must have; null takes any file."""
    provider: OnnxProvider | None = None
    """What runs the model; null: the first of this list that is installed."""

    def open(self) -> OnnxModel:
        """The model, loaded."""
        return OnnxModel(self.model, self.sha256, self.provider)
