"""From photographs with poses to views; every loader of real pictures ends here."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from registry import SceneError, View

from ._images import Decoder, find_image, in_parallel, read_mask, stored_size
from ._lens import Lens, undistort

Notes = dict[str, str | int | float | list[int]]


@dataclass(frozen=True, eq=False)
class PosedPhoto:
    """A photograph on disk and what is known of its camera.

    Args:
        name: of the view.
        path: of the image file; another ending than the file's own does not matter.
        world_to_camera: `[4, 4]` float64, OpenCV axes.
        lens: for the size that the camera file speaks of; it is scaled to the image's.
        where: the place in the camera file, for error messages.
        mask: a picture that is white where pixels count in metrics.
    """

    name: str
    path: Path
    world_to_camera: NDArray[np.float64]
    lens: Lens
    where: str
    mask: Path | None = None


def load_views(photos: Sequence[PosedPhoto], decoder: Decoder) -> list[View]:
    """Decode, undistort and check photographs in parallel.

    Raises:
        SceneError: an image or mask that cannot be read, or does not fit its camera.
    """
    return in_parallel(lambda photo: _load_view(photo, decoder), photos)


def _load_view(photo: PosedPhoto, decoder: Decoder) -> View:
    pixels = decoder.read(find_image(photo.path))
    height, width = pixels.shape[:2]
    distorted = photo.lens.resized(width, height, photo.where)
    lens, pixels = undistort(distorted, pixels, photo.where)
    mask = None
    if photo.mask is not None:
        _, white = undistort(distorted, read_mask(photo.mask, (width, height)), photo.where)
        mask = torch.from_numpy(white == 255)
    return View(
        name=photo.name,
        camera=lens.camera(photo.world_to_camera, photo.where),
        image=torch.from_numpy(pixels.astype(np.float32) / 255),
        mask=mask,
    )


def facts(
    photos: Sequence[PosedPhoto],
    views: Sequence[View],
    decoder: Decoder,
    bounds: tuple[float, float],
) -> Notes:
    """What was found, for the scene's notes.

    Args:
        photos, views: of the training views first, in one order.
    """
    camera = views[0].camera
    return {
        "source": photos[0].path.parent.name,
        "resolution": f"{camera.width}x{camera.height}",
        "focal_x": camera.fx,
        "focal_y": camera.fy,
        "near": bounds[0],
        "far": bounds[1],
        "image_memory_mb": round(sum(v.image.nbytes for v in views) / 1e6, 1),
        "changed": "; ".join(_changes(photos[0], views[0], decoder)) or "nothing",
    }


def _changes(photo: PosedPhoto, view: View, decoder: Decoder) -> list[str]:
    stored = stored_size(find_image(photo.path), upright=decoder.upright)
    size = decoder.size(*stored)
    changes = []
    if size != stored:
        changes.append(
            f"resized from {stored[0]}x{stored[1]} to {size[0]}x{size[1]} "
            f"with the {decoder.resize_filter} filter"
        )
    if not photo.lens.is_pinhole:
        changes.append(
            f"undistorted ({photo.lens.model}) and cropped to what was seen, by pycolmap, bilinear"
        )
    return changes


def require_one_size(photos: Sequence[PosedPhoto], views: Sequence[View]) -> None:
    """Refuse views of several sizes where the format promises one.

    Raises:
        SceneError: names the first view that differs from most.
    """
    sizes = [(view.camera.width, view.camera.height) for view in views]
    usual = max(sizes, key=sizes.count)
    for photo, size in zip(photos, sizes, strict=True):
        if size != usual:
            raise SceneError(
                f"the image is {size[0]}x{size[1]}, the others are {usual[0]}x{usual[1]}",
                where=str(photo.path),
                fix="resize all photographs of the scene in one way",
            )
