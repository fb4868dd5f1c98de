"""Folders of test photographs, their reconstruction, and errors of cameras."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from core_rasterizer import Camera
from registry import Scene
from registry.toolkit.photos import Decoder, import_pycolmap, longest_side
from stereogs_plugins.scenes.photos import PhotosScene
from stereogs_plugins.scenes.photos.photogrammetry import structure_from_motion
from stereogs_plugins.scenes.photos.photogrammetry.mapping import Piece
from stereogs_plugins.scenes.photos.photogrammetry.structure_from_motion import Reconstruction
from stereogs_plugins.scenes.photos.unposed_photos import UnposedPhoto
from tests.stereogs_plugins.building import build

if TYPE_CHECKING:
    from stereogs_plugins.scenes.photos.photogrammetry.colmap import Model

Array = NDArray[np.float64]
FOCAL_35MM, EXIF_BLOCK = 0xA405, 0x8769
COUNT, SIDEWAYS = 5, 2
"""Number of photographs in `folder`, and the one that is stored sideways."""
MATCHES = {(0, 1): 200, (0, 2): 90, (1, 2): 150, (3, 4): 80, (2, 3): 12, (1, 3): 9}


def load(folder: Path, **settings: object) -> Scene:
    return build(PhotosScene, path=folder, **settings).load()


def reconstruct(photos: Sequence[UnposedPhoto], folder: Path) -> Reconstruction:
    """As the loader does by default, in a folder that may be missing."""
    folder.mkdir(exist_ok=True)
    decoder = Decoder(longest_side(1200), "box", upright=True)
    return structure_from_motion.reconstruct(photos, decoder, True, folder)


def with_focal(millimetres: float) -> Image.Exif:
    """EXIF data with a 35 mm equivalent focal length."""
    exif = Image.Exif()
    exif.get_ifd(EXIF_BLOCK)[FOCAL_35MM] = millimetres
    return exif


def turn(model: Model, image: int, axis: Sequence[float], degrees: float) -> None:
    """Turn the camera of an image id on the spot."""
    colmap = import_pycolmap(3)
    frame = model.frame(model.image(image).frame_id)
    half = np.radians(degrees) / 2
    turned = colmap.Rotation3d(np.array([*np.sin(half) * np.array(axis), np.cos(half)]))
    pose = frame.rig_from_world
    assert pose is not None
    frame.rig_from_world = colmap.Rigid3d(turned * pose.rotation, turned * pose.translation)


def angles(turns: Sequence[Array] | Array) -> Array:
    """Angles of rotations `[N, 3, 3]`, degrees."""
    cosines = (np.trace(np.asarray(turns), axis1=1, axis2=2) - 1) / 2
    degrees: Array = np.degrees(np.arccos(np.clip(cosines, -1, 1)))
    return degrees


def relative_turns(found: Sequence[Array], truth: Sequence[Array]) -> Array:
    """Errors of the rotations `[3, 3]` between each two cameras, degrees."""
    pairs = itertools.combinations(range(len(found)), 2)
    return angles([truth[b] @ truth[a].T @ (found[b] @ found[a].T).T for a, b in pairs])


def pose_errors(found: list[Camera], truth: list[Camera]) -> tuple[Array, Array]:
    """Degrees, after the similarity that aligns the camera centres best (Umeyama 1991).

    Returns:
        the angle of each rotation, and of the line between each two cameras.
    """
    rotation = [np.stack([c.world_to_camera[:3, :3].numpy().T for c in s]) for s in (found, truth)]
    center = [np.stack([c.center.numpy() for c in s]) for s in (found, truth)]
    center = [positions - positions.mean(axis=0) for positions in center]
    u, _, v = np.linalg.svd(center[1].T @ center[0])
    aligned = u @ np.diag([1, 1, np.linalg.det(u @ v)]) @ v
    first, second = np.triu_indices(len(found), 1)
    lines = [p[first] - p[second] for p in (center[0] @ aligned.T, center[1])]
    lines = [line / np.linalg.norm(line, axis=1, keepdims=True) for line in lines]
    along = (lines[0] * lines[1]).sum(axis=1)
    directions = np.degrees(np.arccos(np.clip(along, -1, 1)))
    return angles(np.swapaxes(rotation[1], 1, 2) @ aligned @ rotation[0]), directions


def reconstruction_of(entry: Path) -> Reconstruction:
    """Content of a cache entry, with other matches."""
    return Reconstruction([Piece(entry / "piece_0", [0, 1, 2, 3, 4])], MATCHES, [900] * COUNT)


def write_pictures(folder: Path, count: int) -> None:
    for index in range(count):
        Image.new("RGB", (40, 30), (60 * index, 0, 0)).save(folder / f"{index}.jpg")
