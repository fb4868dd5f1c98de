"""What every prior that runs an ONNX file lets a pipeline say."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import Field

from ...contract.component import Settings
from .model_file import Sha256
from .onnx_session import OnnxProvider

if TYPE_CHECKING:
    from .onnx_model import OnnxModel


class OnnxModelSettings(Settings):
    model: Path
    """The local ONNX file; weights belong inside it."""
    sha256: Sha256 | None = None
    """The hash that the file must have; null takes any file."""
    provider: OnnxProvider | None = None
    """What runs the model; null: the first of this list that is installed."""
    threads: int | None = Field(None, ge=1)
    """Processor threads that run the model; null: as many as this process may use."""

    @classmethod
    def naming(cls, model: OnnxModel) -> dict[str, str]:
        """The settings that name a model's file, as a pipeline holds them."""
        return {"model": str(model.path), "sha256": model.sha256}

    def open(self) -> OnnxModel:
        """The model, loaded."""
        return self.open_another(self.model, self.sha256)

    def open_another(self, path: Path, sha256: str | None) -> OnnxModel:
        """A second file that belongs to the model, run in the same way."""
        from .onnx_model import OnnxModel

        return OnnxModel(path, sha256, self.provider, threads=self.threads)
