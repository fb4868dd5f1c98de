"""`ply`: the standard 3D Gaussian Splatting PLY, readable by public viewers."""

from __future__ import annotations

from typing import TYPE_CHECKING

from registry import Exporter, Scene, Settings

from .cameras import write_cameras

if TYPE_CHECKING:
    from pathlib import Path

    from core_rasterizer import GaussianReader


class PlyExporter(Exporter[Settings]):
    """Writes scene.ply: means, spherical harmonics, opacity logits, log-scales, quaternions.

    Beside it lies cameras.json, which viewers of the 3DGS code read.
    """

    def export(self, model: GaussianReader, scene: Scene, folder: Path) -> list[Path]:
        """Write the two files and return their paths."""
        from core_rasterizer import save_ply

        path = folder / "scene.ply"
        save_ply(model.gaussians(), path)
        return [path, write_cameras(scene, folder)]
