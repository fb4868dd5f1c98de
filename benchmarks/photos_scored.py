"""PSNR of a scene trained with estimated cameras, and of the same with published ones.

The middle one of the placed photographs is held out; the others train `weightfree_quick` at a small size.
Both trainings use the same photographs, undistorted with the estimated lens. Points only set the depth range.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

import stereogs
from benchmarks.photos_published import Published
from registry import PointCloud, Scene
from registry.toolkit.photos import (
    ColmapModel,
    Decoder,
    Lens,
    LoadedPhotos,
    PosedPhoto,
    estimate_bounds,
    longest_side,
)
from stereogs_plugins.scenes.photos.photogrammetry.colmap import image_index
from stereogs_plugins.scenes.photos.unposed_photos import UnposedPhoto

PIPELINE = "weightfree_quick"
SIZE = 320
"""Longer side of the photographs, in pixels."""


def psnr_of_both(
    model: ColmapModel,
    photos: Sequence[UnposedPhoto],
    published: Sequence[Published],
) -> tuple[float, float]:
    """Return PSNR in dB of the held-out photograph with estimated and with published cameras.

    Args:
        model: estimated cameras of photographs that are named by index.
        photos, published: by index.
    """
    images = [image for _, image in model.images]
    indices = [image_index(image.name) for image in images]
    found = [
        _posed(photos[k], image.world_to_camera, model.lens(image))
        for k, image in zip(indices, images, strict=True)
    ]
    # Undistortion blurs, which alone can gain 1 dB: `found` and `true` need the same distortion.
    true = [
        _posed(
            photos[k],
            published[k].pose,
            replace(published[k].lens, model=one.lens.model, distortion=one.lens.distortion),
        )
        for k, one in zip(indices, found, strict=True)
    ]
    test = [len(images) // 2]
    train = [k for k in range(len(images)) if k not in test]
    points = model.tracks().seen_by(train)
    loaded = _loaded(found, train, test)
    bounds = estimate_bounds(loaded.training_cameras, points, "")
    first = _psnr(loaded.scene("photos", Path("photos"), bounds, None, ()))
    return first, _psnr(_published_scene(found, true, points, train, test))


def _published_scene(
    found: list[PosedPhoto],
    true: list[PosedPhoto],
    points: PointCloud | None,
    train: list[int],
    test: list[int],
) -> Scene:
    """The scene with published cameras, which see the points in the same places."""
    loaded = _loaded(true, train, test)
    moved = None
    if points is not None:
        moved = PointCloud(_moved(points.positions, found, true, train), points.colors)
    bounds = estimate_bounds(loaded.training_cameras, moved, "")
    return loaded.scene("photos", Path("photos"), bounds, None, ())


def _moved(
    positions: Tensor, found: list[PosedPhoto], true: list[PosedPhoto], train: list[int]
) -> Tensor:
    """Points `[N, 3]` nearest to the rays of published cameras that see what the estimated ones see."""
    world = np.column_stack([positions.numpy().astype(np.float64), np.ones(len(positions))])
    across, towards = np.zeros((len(world), 3, 3)), np.zeros((len(world), 3))
    for k in train:
        x, y, z = (world @ found[k].world_to_camera.T)[:, :3].T
        lenses = found[k].lens, true[k].lens
        ratio = lenses[0].fx / lenses[0].width / (lenses[1].fx / lenses[1].width)
        rays = np.column_stack([ratio * x / z, ratio * y / z, np.ones(len(z))])
        pose = true[k].world_to_camera
        rays = rays / np.linalg.norm(rays, axis=1, keepdims=True) @ pose[:3, :3]
        part = np.eye(3) - rays[:, :, None] * rays[:, None, :]
        across += part
        towards += part @ -(pose[:3, :3].T @ pose[:3, 3])
    return torch.from_numpy(np.linalg.solve(across, towards[:, :, None])[:, :, 0]).float()


def _posed(photo: UnposedPhoto, pose: NDArray[np.float64], lens: Lens) -> PosedPhoto:
    return PosedPhoto(photo.path.stem, photo.path, pose, lens, str(photo.path))


def _loaded(photos: list[PosedPhoto], train: list[int], test: list[int]) -> LoadedPhotos:
    decoder = Decoder(longest_side(SIZE), "bicubic", upright=True)
    return LoadedPhotos.load([photos[k] for k in train + test], decoder, train, test)


def _psnr(scene: Scene) -> float:
    run = stereogs.train(PIPELINE, scene=scene, progress=False)
    psnr = run.scores["test"].mean["psnr"]
    assert psnr is not None
    return round(float(psnr), 2)
