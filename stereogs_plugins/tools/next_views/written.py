"""Files about suggestions: pictures with hatched guesses, and next.json."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import torch

from registry.system import write_text
from registry.toolkit.drawing import save_png

from .gain import confirmed

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from torch import Tensor

    from core_rasterizer import Camera
    from registry.runs import Run

    from . import NextView

FILE = "next.json"
GUESSED = 0.35
"""Pixels of which photographs confirm less are hatched."""
_PERIOD, _STRIPE = 12, 4
"""Pixels between two stripes, and their width."""
_STRIPE_COLOR = (1.0, 1.0, 1.0)
_STRENGTH = 0.6


def write(run: Run, found: Sequence[NextView], names: Sequence[str] | None, folder: Path) -> None:
    """Write FILE and a picture of each suggestion; remove pictures of earlier ones.

    Args:
        names: of the candidates, if they have names.
    """
    for old in folder.glob("*.png"):
        old.unlink()
    listed = []
    for number, one in enumerate(found, start=1):
        rgb = run.rendering(one.camera).rgb
        sure = confirmed(run.rendering, [view.camera for view in run.scene.train], one.camera)
        save_png(hatched(rgb, sure < GUESSED), folder / f"{number}.png")
        listed.append(
            {
                "picture": f"{number}.png",
                "name": None if names is None else names[one.index],
                "words": one.words,
                "gain": round(one.gain, 4),
                "overlap": round(one.overlap, 4),
                **_camera(one.camera),
            }
        )
    write_text(folder / FILE, json.dumps({"frames": listed}, indent=1) + "\n")


def hatched(rgb: Tensor, where: Tensor) -> Tensor:
    """Draw diagonal stripes over the pixels `where`, `[H, W]` bool, of an image `[H, W, 3]`."""
    rows, columns = torch.meshgrid(*(torch.arange(n) for n in where.shape), indexing="ij")
    stripes = where & ((rows + columns) % _PERIOD < _STRIPE)
    mixed = (1 - _STRENGTH) * rgb + _STRENGTH * rgb.new_tensor(_STRIPE_COLOR)
    return torch.where(stripes[..., None], mixed, rgb)


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
