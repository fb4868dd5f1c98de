"""A program that writes the points of its COLMAP folder before a grey wall as Gaussians, or grey renders.

    python stand_in.py MODE DATA OUT [CAMERAS RENDERS]

MODE: gaussians, silent (writes nothing), failing (status 3), hanging, moved (the world is moved), damaged,
renders, small (renders of another size). It imports what a mode needs, to start quickly.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path


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
    return train(mode, Path(data), Path(out))


def train(mode: str, data: Path, out: Path) -> int:
    import numpy as np
    import pycolmap
    import torch

    from core_rasterizer import Gaussians, save_ply

    model = pycolmap.Reconstruction(str(data / "sparse" / "0"))
    names = sorted(image.name for image in model.images.values())
    (out / "seen.json").write_text(json.dumps(names))
    if sorted(path.name for path in (data / "images").iterdir()) != names:
        return 4
    points = [model.points3D[key] for key in sorted(model.points3D)]
    means = torch.tensor(np.array([point.xyz for point in points]), dtype=torch.float32)
    colors = torch.tensor(np.array([point.color for point in points]) / 255, dtype=torch.float32)
    # The wall is a sphere around the cameras, in the grey of the photographs.
    wall = torch.nn.functional.normalize(
        torch.randn(4000, 3, generator=torch.Generator().manual_seed(0))
    )
    sizes = torch.cat([torch.full((len(means), 3), -3.0), torch.full((4000, 3), -1.2)])
    means, colors = torch.cat([means, 7 * wall]), torch.cat([colors, 0 * wall + 60 / 255])
    count = len(means)
    for step, opacity in ((1, -6.0), (2, 6.0)):
        gaussians = Gaussians(
            means=means + 1000 * (mode == "moved"),
            log_scales=sizes,
            quaternions=torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(count, 1),
            opacity_logits=torch.full((count,), opacity),
            sh=((colors - 0.5) / 0.28209479177387814)[:, None],
        )
        file = out / f"splat_{step}.ply"
        save_ply(gaussians, file)
        if mode == "damaged":
            file.write_bytes(file.read_bytes()[:-9])
        time.sleep(0.2)
    return 0


def render(mode: str, cameras: Path, renders: Path) -> int:
    from PIL import Image

    for frame in json.loads((cameras / "transforms.json").read_text())["frames"]:
        if Image.open(cameras / frame["file_path"]).getextrema() != ((0, 0),) * 3:
            return 5  # a test photograph
        shrink = 2 if mode == "small" else 1
        size = (frame["w"] // shrink, frame["h"] // shrink)
        Image.new("RGB", size, (60, 60, 60)).save(renders / Path(frame["file_path"]).name)
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
