"""`ply` and `cameras`: the 3D Gaussian Splatting PLY with cameras.json, or only that file, for viewers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from registry import Exporter, Register, Scene, Settings, hookimpl
from registry.toolkit import write_text

if TYPE_CHECKING:
    from pathlib import Path

    from core_rasterizer import Camera, GaussianReader


class CamerasExporter(Exporter[Settings]):
    """Writes cameras.json: position, rotation and focal lengths of all views, training views first.

    The format has no principal point: viewers use the centre of the image.
    """

    def export(self, model: GaussianReader, scene: Scene, folder: Path) -> list[Path]:
        """Write the file and return its path."""
        return [_write_cameras(scene, folder)]


class PlyExporter(Exporter[Settings]):
    """Writes cameras.json and scene.ply: means, SH, opacity logits, log-scales, quaternions, attributes."""

    def export(self, model: GaussianReader, scene: Scene, folder: Path) -> list[Path]:
        """Write the two files and return their paths."""
        from core_rasterizer import save_ply

        path = folder / "scene.ply"
        save_ply(model.gaussians(), path, model.attributes)
        return [path, _write_cameras(scene, folder)]


def _write_cameras(scene: Scene, folder: Path) -> Path:
    import json

    views = enumerate((*scene.train, *scene.test))
    cameras = [_described(index, view.name, view.camera) for index, view in views]
    path = folder / "cameras.json"
    write_text(path, json.dumps(cameras, indent=1) + "\n")
    return path


def _described(index: int, name: str, camera: Camera) -> dict[str, Any]:
    """Return a camera's entry; the columns of `rotation` are the camera's axes."""
    pose = camera.camera_to_world
    return {
        "id": index,
        "img_name": name,
        "width": camera.width,
        "height": camera.height,
        "position": pose[:3, 3].tolist(),
        "rotation": pose[:3, :3].tolist(),
        "fy": camera.fy,
        "fx": camera.fx,
    }


@hookimpl
def stereogs_register_exporters(register: Register[CamerasExporter | PlyExporter]) -> None:
    register("ply", PlyExporter)
    register("cameras", CamerasExporter)
