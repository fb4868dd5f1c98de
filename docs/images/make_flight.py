"""Makes flight.webp, the README's moving picture: a flight through the room that `make demo` reconstructs.

Run it in the repository's root: `.venv/bin/python docs/images/make_flight.py`.
"""

from __future__ import annotations

from pathlib import Path

from PIL import Image

import stereogs
from registry.toolkit.drawing.camera_path import smooth_path
from registry.toolkit.drawing.pictures import depth_picture, side_by_side, to_bytes

ROOT = Path(__file__).parents[2]
FRAMES, MILLISECONDS = 48, 70


def main() -> None:
    """Train the demo's pipeline on the drawn room, fly between its three photographs, write the file."""
    run = stereogs.train(ROOT / "pipelines" / "demo.yaml")
    path = smooth_path([view.camera for view in run.scene.train], FRAMES)
    renderings = (run.rendering(camera) for camera in path)
    frames = [side_by_side(seen.rgb, depth_picture(seen)) for seen in renderings]
    first, *others = (Image.fromarray(to_bytes(frame)) for frame in frames)
    first.save(
        Path(__file__).with_name("flight.webp"),
        save_all=True,
        append_images=others,
        duration=MILLISECONDS,
        loop=0,
        quality=70,
        method=4,
    )


if __name__ == "__main__":
    main()
