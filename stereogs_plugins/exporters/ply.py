"""`ply`: the standard 3D Gaussian Splatting PLY, readable by public viewers."""

from __future__ import annotations

from typing import TYPE_CHECKING

from registry import Exporter, Register, Scene, Settings, hookimpl

if TYPE_CHECKING:
    from pathlib import Path

    from core_rasterizer import GaussianReader


class PlyExporter(Exporter[Settings]):
    """Writes scene.ply: means, spherical harmonics, opacity logits, log-scales, quaternions."""

    def export(self, model: GaussianReader, scene: Scene, folder: Path) -> list[Path]:
        """Write the file and return its path."""
        from core_rasterizer import save_ply

        path = folder / "scene.ply"
        save_ply(model.gaussians(), path)
        return [path]


@hookimpl
def stereogs_register_exporters(register: Register[PlyExporter]) -> None:
    register("ply", PlyExporter)
