"""PSNR of a scene trained with estimated cameras, and of the same with published ones.

The middle one of the placed photographs is held out; the others train `weightfree_quick` at a small size.
Both trainings use the same photographs and depth range, and no points.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import stereogs
from benchmarks.photos_published import Published
from registry import Scene
from registry.toolkit.photos import (
    ColmapModel,
    Decoder,
    Lens,
    LoadedPhotos,
    PosedPhoto,
    estimate_bounds,
    longest_side,
)
from stereogs_plugins.scenes.photos.unposed_photos import UnposedPhoto, image_index

PIPELINE = "weightfree_quick"
SIZE = 320
"""Longer side of the photographs, in pixels."""


def psnr_of_both(
    model: ColmapModel,
    photos: Sequence[UnposedPhoto],
    published: Sequence[Published],
    scale: float,
) -> tuple[float, float]:
    """Return PSNR in dB of the held-out photograph with estimated and with published cameras.

    Args:
        model: estimated cameras of photographs that are named by index.
        photos, published: by index.
        scale: of the published world, in units of the estimated one.
    """
    images = [image for _, image in model.images]
    indices = [image_index(image.name) for image in images]
    found = [
        _posed(photos[k], image.world_to_camera, model.lens(image))
        for k, image in zip(indices, images, strict=True)
    ]
    true = [_posed(photos[k], published[k].pose, published[k].lens) for k in indices]
    test = [len(images) // 2]
    train = [k for k in range(len(images)) if k not in test]
    points = model.tracks().seen_by(train)
    loaded = _loaded(found, train, test)
    near, far = estimate_bounds(loaded.training_cameras, points, "")
    # Depth is proportional to the focal length: the disparities are known.
    ratio = scale * true[0].lens.fx / true[0].lens.width / (found[0].lens.fx / found[0].lens.width)
    first = _psnr(loaded.scene("photos", Path("photos"), (near, far), None, ()))
    scene = _loaded(true, train, test).scene(
        "photos", Path("photos"), (near * ratio, far * ratio), None, ()
    )
    return first, _psnr(scene)


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
