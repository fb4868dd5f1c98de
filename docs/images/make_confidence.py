"""Makes confidence.webp: a render, its guessed parts, and its confidence. See docs/confidence.md.

Run it in the repository's root, with STEREOGS_DATA set: `.venv/bin/python docs/images/make_confidence.py`.
"""

from __future__ import annotations

from pathlib import Path

import torch
from PIL import Image

import stereogs
from registry.toolkit.drawing import side_by_side, to_bytes
from stereogs.confidence_picture import hatched, with_scale

ROOT = Path(__file__).parents[2]
SHOWN = 2
"""Which of the test views."""


def main() -> None:
    """Train on three photographs of the fern and write the picture."""
    run = stereogs.train(ROOT / "pipelines" / "weightfree_quick.yaml", progress=False)
    camera = run.scene.test[SHOWN].camera
    rgb, confidence = run.rendering(camera).rgb, run.confidence("calibrated").of(camera)
    colors = with_scale(confidence)
    below = torch.ones(len(colors) - len(rgb), camera.width, 3)
    left = [torch.cat([image, below]) for image in (rgb, hatched(rgb, confidence))]
    picture = Image.fromarray(to_bytes(side_by_side(*left, colors)))
    picture.save(ROOT / "docs" / "images" / "confidence.webp", quality=80, method=6)


if __name__ == "__main__":
    main()
