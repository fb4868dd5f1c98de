"""A program that writes the points of its COLMAP folder before a grey wall as Gaussians, or grey renders.

    python stand_in.py MODE DATA OUT [CAMERAS RENDERS]

MODE: gaussians, silent (writes nothing), failing (status 3), hanging, moved (the world is moved), damaged,
renders, small (renders of another size).
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import numpy as np
import pycolmap
import torch
from PIL import Image

from core_rasterizer import Gaussians, save_ply

GREY = 60 / 255
"""Of the background in the photographs of `World`."""


def main(mode: str, data: str, out: str, *places: str) -> int:
    if mode == "silent":
        return 0
    if mode == "failing":
        print("out of luck")
        return 3
    if mode == "hanging":
        time.sleep(60)
    if places:
        return render(mode, *map(Path, places))
    model = pycolmap.Reconstruction(str(Path(data, "sparse", "0")))
    names = sorted(image.name for image in model.images.values())
    Path(out, "seen.json").write_text(json.dumps(names))
    if sorted(path.name for path in Path(data, "images").iterdir()) != names:
        return 4
    points = [model.points3D[key] for key in sorted(model.points3D)]
    means = torch.tensor(np.array([point.xyz for point in points]), dtype=torch.float32)
    colors = torch.tensor(np.array([point.color for point in points]) / 255, dtype=torch.float32)
    means, colors = torch.cat([means, backdrop()]), torch.cat([colors, torch.full((4000, 3), GREY)])
    for step, opacity in ((1, -6.0), (2, 6.0)):
        file = Path(out, f"splat_{step}.ply")
        save_ply(gaussians(means + 1000 * (mode == "moved"), colors, opacity), file)
        if mode == "damaged":
            file.write_bytes(file.read_bytes()[:-9])
        time.sleep(0.2)
    return 0


def backdrop() -> torch.Tensor:
    """Points on a sphere around the cameras of `World`."""
    points = torch.randn(4000, 3, generator=torch.Generator().manual_seed(0))
    return torch.nn.functional.normalize(points) * 7


def gaussians(means: torch.Tensor, colors: torch.Tensor, opacity: float) -> Gaussians:
    count = len(means)
    sizes = torch.where(means.norm(dim=1) > 6, -1.2, -3.0)
    return Gaussians(
        means=means,
        log_scales=sizes[:, None].repeat(1, 3),
        quaternions=torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(count, 1),
        opacity_logits=torch.full((count,), opacity),
        sh=((colors - 0.5) / 0.28209479177387814)[:, None],
    )


def render(mode: str, cameras: Path, renders: Path) -> int:
    frames = json.loads((cameras / "transforms.json").read_text())["frames"]
    for frame in frames:
        photograph = Image.open(cameras / frame["file_path"])
        assert np.asarray(photograph).max() == 0
        shrink = 2 if mode == "small" else 1
        size = (frame["w"] // shrink, frame["h"] // shrink)
        Image.new("RGB", size, (60, 60, 60)).save(renders / Path(frame["file_path"]).name)
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
