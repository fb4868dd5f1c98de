"""What viewers of 3D Gaussian Splatting open: `ply`, with `cameras.json` beside it, and `cameras` alone."""

from __future__ import annotations

from registry import Register, hookimpl

from .cameras import CamerasExporter
from .gaussians import PlyExporter

__all__ = ["CamerasExporter", "PlyExporter"]


@hookimpl
def stereogs_register_exporters(register: Register[CamerasExporter | PlyExporter]) -> None:
    register("ply", PlyExporter)
    register("cameras", CamerasExporter)
