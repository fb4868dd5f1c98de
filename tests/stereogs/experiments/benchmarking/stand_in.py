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

    model = pycolmap.Reconstruction(str(data / "sparse" / "0"))
    names = sorted(image.name for image in model.images.values())
    (out / "seen.json").write_text(json.dumps(names))
    if sorted(path.name for path in (data / "images").iterdir()) != names:
        return 4
    points = [model.points3D[key] for key in sorted(model.points3D)]
    # The wall is a sphere around the cameras, in the grey of the photographs.
    wall = np.random.default_rng(0).normal(size=(4000, 3))
    wall *= 7 / np.linalg.norm(wall, axis=1, keepdims=True)
    means = np.concatenate([[point.xyz for point in points], wall]) + 1000 * (mode == "moved")
    colors = np.concatenate([[point.color for point in points], np.full((4000, 3), 60)]) / 255
    sizes = np.repeat([-3.0, -1.2], [len(points), 4000])[:, None].repeat(3, axis=1)
    rotations = np.tile([1.0, 0.0, 0.0, 0.0], (len(means), 1))
    properties = (
        "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3"
    )
    for step, opacity in ((1, -6.0), (2, 6.0)):
        opacities = np.full((len(means), 1), opacity)
        bands = (colors - 0.5) / 0.28209479177387814
        rows = np.concatenate([means, bands, opacities, sizes, rotations], axis=1).astype("<f4")
        header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(means)}"]
        header += [f"property float {name}" for name in properties.split()]
        content = "\n".join([*header, "end_header\n"]).encode() + rows.tobytes()
        (out / f"splat_{step}.ply").write_bytes(content[: -9 if mode == "damaged" else None])
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
