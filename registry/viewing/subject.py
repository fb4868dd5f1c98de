"""What is looked at: Gaussians, and what is known about the photographs that they were made from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from torch import Tensor

from core_rasterizer import Device, GaussianModel, load_ply

from ..contract.scene import Scene
from ..runs.run import Run


@dataclass(frozen=True, eq=False)
class Subject:
    """Gaussians to be looked at.

    Args:
        name: for the page's title.
        model: the Gaussians.
        scene: their photographs and cameras; None for a file alone.
        kinds: which Gaussians descend from initial points of a kind, `[N]` bool by its name.
    """

    name: str
    model: GaussianModel
    scene: Scene | None = None
    kinds: Mapping[str, Tensor] = field(default_factory=dict)

    @property
    def background(self) -> tuple[float, float, float]:
        """The scene's, else black."""
        return self.scene.background if self.scene else (0.0, 0.0, 0.0)


def of_run(run: Run) -> Subject:
    """A run as it stands."""
    return Subject(f"{run.scene.name}, {run.pipeline.name}", run.model, run.scene, run.kinds)


def of_file(path: Path, device: Device) -> Subject:
    """The Gaussians of a PLY file.

    Raises:
        PlyError: it cannot be read, or holds no Gaussians.
    """
    return Subject(path.name, GaussianModel(load_ply(path), device))
