"""`cameras`: cameras.json, the list of cameras that the 3DGS code writes and its viewers read."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from registry import Exporter, Scene, Settings
from registry.system import write_text

if TYPE_CHECKING:
    from pathlib import Path

    from core_rasterizer import Camera, GaussianReader


class CamerasExporter(Exporter[Settings]):
    """Writes cameras.json: place, rotation and focal lengths of all views, training views first."""

    def export(self, model: GaussianReader, scene: Scene, folder: Path) -> list[Path]:
        """Write the file and return its path."""
        return [write_cameras(scene, folder)]


def write_cameras(scene: Scene, folder: Path) -> Path:
    """Write cameras.json into a folder.

    The format has no principal point: viewers put it in the middle of the image.
    """
    import json

    views = (*scene.train, *scene.test)
    listed = [_described(index, view.name, view.camera) for index, view in enumerate(views)]
    path = folder / "cameras.json"
    write_text(path, json.dumps(listed, indent=1) + "\n")
    return path


def _described(index: int, name: str, camera: Camera) -> dict[str, Any]:
    """A camera as the 3DGS code lists it: `rotation` holds the axes of the camera in its columns."""
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
