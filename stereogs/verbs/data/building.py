"""Write what a protocol makes of a folder: photographs at its size, masks, cameras and the split."""

from __future__ import annotations

import shutil
from pathlib import Path

from registry import RunError
from registry.pipeline.protocols import load_protocol
from registry.toolkit.photos import list_images, open_8_bit

from ...protocol_scene import pipeline_of, write_scene
from ...session import load_scene

FACTOR = 8
"""LLFF and Mip-NeRF 360 are distributed with photographs of an eighth of the size, which protocols use."""
_COPIED = ("poses_bounds.npy", "points3d.npz", "split.json", "sparse")


def build(protocol: str, folder: Path, out: Path, layout: str) -> list[Path]:
    """Write the views of a protocol in a layout of other programs, and reduced photographs if it needs them.

    Args:
        out: a new or empty folder.
        layout: as for `write_scene`.

    Returns:
        The files.

    Raises:
        RunError: `out` is not empty.
        SceneError: the folder cannot be read.
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise RunError("the folder is not empty", where=str(out), fix="choose another --out")
    reduced = _reduce(protocol, folder, out)
    scene = load_scene(pipeline_of(protocol, out if reduced else folder))
    return [*reduced, *write_scene(scene, layout, out)]


def _reduce(protocol: str, folder: Path, out: Path) -> list[Path]:
    """Write images_8 from images as means of 8x8 pixels, if the protocol reads it and it is missing."""
    small, large = folder / f"images_{FACTOR}", list_images(folder / "images")
    if load_protocol(protocol).image_source == "resize" or list_images(small) or not large:
        return []
    written = [out / small.name / f"{path.stem}.png" for path in large]
    written[0].parent.mkdir(parents=True)
    for path, file in zip(large, written, strict=True):
        with open_8_bit(path) as image:
            image.convert("RGB").reduce(FACTOR).save(file)
    for name in _COPIED:
        source = folder / name
        if source.is_dir():
            shutil.copytree(source, out / name)
        elif source.is_file():
            shutil.copyfile(source, out / name)
    return written
