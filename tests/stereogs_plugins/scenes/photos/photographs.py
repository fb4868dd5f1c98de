"""Folders of test photographs, and errors of estimated cameras."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from core_rasterizer import Camera
from registry import Scene
from stereogs_plugins.scenes.photos import PhotosScene
from stereogs_plugins.scenes.photos.mapping import Piece
from stereogs_plugins.scenes.photos.structure_from_motion import Reconstruction
from tests.stereogs_plugins.building import build

Array = NDArray[np.float64]
COUNT, SIDEWAYS = 5, 2
"""Number of photographs in `folder`, and the one that is stored sideways."""
MATCHES = {(0, 1): 200, (0, 2): 90, (1, 2): 150, (3, 4): 80, (2, 3): 12, (1, 3): 9}


def load(folder: Path, **settings: object) -> Scene:
    return build(PhotosScene, path=folder, **settings).load()


def pose_errors(found: list[Camera], truth: list[Camera]) -> tuple[Array, Array]:
    """Degrees, after the similarity that aligns the camera centres best (Umeyama 1991).

    Returns:
        the angle of each rotation, and of the line between each two cameras.
    """
    rotation = [np.stack([c.world_to_camera[:3, :3].numpy().T for c in s]) for s in (found, truth)]
    center = [np.stack([c.center.numpy() for c in s]) for s in (found, truth)]
    center = [positions - positions.mean(axis=0) for positions in center]
    u, _, v = np.linalg.svd(center[1].T @ center[0])
    turn = u @ np.diag([1, 1, np.linalg.det(u @ v)]) @ v
    residual = np.swapaxes(rotation[1], 1, 2) @ turn @ rotation[0]
    cosines = (np.trace(residual, axis1=1, axis2=2) - 1) / 2
    first, second = np.triu_indices(len(found), 1)
    lines = [p[first] - p[second] for p in (center[0] @ turn.T, center[1])]
    lines = [line / np.linalg.norm(line, axis=1, keepdims=True) for line in lines]
    along = (lines[0] * lines[1]).sum(axis=1)
    rotations, directions = (np.degrees(np.arccos(np.clip(c, -1, 1))) for c in (cosines, along))
    return rotations, directions


def reconstruction_of(entry: Path) -> Reconstruction:
    """Content of a cache entry, with other matches."""
    return Reconstruction([Piece(entry / "piece_0", [0, 1, 2, 3, 4])], MATCHES, [900] * COUNT)


def write_pictures(folder: Path, count: int) -> None:
    for index in range(count):
        Image.new("RGB", (40, 30), (60 * index, 0, 0)).save(folder / f"{index}.jpg")
