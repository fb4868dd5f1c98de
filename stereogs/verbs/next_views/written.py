"""Files about suggestions: pictures with hatched guesses, and next.json."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from registry.system.files import write_text
from registry.toolkit.drawing import save_png

from ...confidence_picture import hatched

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from core_rasterizer import Camera
    from registry.runs.run import Run

    from . import NextView

FILE = "next.json"
ESTIMATOR, SHOWN = "coverage", 0.1
"""Pixels around which this confidence is lower are hatched: no photograph shows them, or only from far aside.
A calibrated confidence would be high for a blurred margin, whose colours are nearly right."""


def write(run: Run, found: Sequence[NextView], names: Sequence[str] | None, folder: Path) -> None:
    """Write FILE and a picture of each suggestion; remove pictures of earlier ones.

    Args:
        names: of the candidates, if they have names.
    """
    for old in folder.glob("*.png"):
        old.unlink()
    confidence, listed = run.confidence(ESTIMATOR), []
    for number, view in enumerate(found, start=1):
        rendered = run.rendering(view.camera).rgb
        drawn = hatched(rendered, confidence.of(view.camera), SHOWN)
        save_png(drawn, folder / f"{number}.png")
        listed.append(
            {
                "picture": f"{number}.png",
                "name": None if names is None else names[view.index],
                "words": view.words,
                "gain": round(view.gain, 4),
                "overlap": round(view.overlap, 4),
                **_camera(view.camera),
            }
        )
    content = {"iteration": run.iteration, "frames": listed}
    write_text(folder / FILE, json.dumps(content, indent=1) + "\n")


def _camera(camera: Camera) -> dict[str, object]:
    """Return a camera in the words of transforms.json; the pose has OpenGL's axes."""
    pose = camera.camera_to_world
    pose[:3, 1:3] *= -1
    return {
        "transform_matrix": pose.tolist(),
        "fl_x": camera.fx,
        "fl_y": camera.fy,
        "cx": camera.cx,
        "cy": camera.cy,
        "w": camera.width,
        "h": camera.height,
    }
