"""`transforms`: the photographs and cameras as nerfstudio's transforms.json."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from registry import Exporter, Register, Scene, Settings, hookimpl
from registry.toolkit import write_text
from registry.toolkit.drawing import save_png

if TYPE_CHECKING:
    from pathlib import Path

    from core_rasterizer import Camera, GaussianReader
    from registry import View


class TransformsExporter(Exporter[Settings]):
    """Writes transforms/transforms.json and transforms/images: PNG images, poses and intrinsics.

    `train_filenames` and `test_filenames` contain the split, and `mask_path` the masks.
    """

    def export(self, model: GaussianReader, scene: Scene, folder: Path) -> list[Path]:
        """Write the files and return their paths."""
        import json

        place = folder / "transforms"
        (place / "images").mkdir(parents=True, exist_ok=True)
        written, frames = [], []
        for view in (*scene.train, *scene.test):
            written.append(place / _file(view))
            save_png(view.image, written[-1])
            frames.append({"file_path": _file(view), **_described(view.camera)})
            if view.trained is not None:
                frames[-1]["mask_path"] = f"masks/{view.name}.png"
                written.append(place / frames[-1]["mask_path"])
                written[-1].parent.mkdir(exist_ok=True)
                save_png(255 * view.trained.byte(), written[-1])
        content = {
            "camera_model": "OPENCV",
            "train_filenames": [_file(view) for view in scene.train],
            "test_filenames": [_file(view) for view in scene.test],
            "frames": frames,
        }
        path = place / "transforms.json"
        write_text(path, json.dumps(content, indent=1) + "\n")
        return [path, *written]


def _file(view: View) -> str:
    return f"images/{view.name}.png"


def _described(camera: Camera) -> dict[str, Any]:
    """Return a frame's camera, with OpenGL's axes: x right, y up, z back."""
    pose = camera.camera_to_world.clone()
    pose[:, 1:3] *= -1
    return {
        "w": camera.width,
        "h": camera.height,
        "fl_x": camera.fx,
        "fl_y": camera.fy,
        "cx": camera.cx,
        "cy": camera.cy,
        "transform_matrix": pose.tolist(),
    }


@hookimpl
def stereogs_register_exporters(register: Register[TransformsExporter]) -> None:
    register("transforms", TransformsExporter)
