"""From photographs with poses to views."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ...contract.scene import View
from ...system.parallel import in_parallel
from .cameras.undistortion import undistort
from .images.decoder import Decoder, read_mask
from .images.image_files import find_image

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from .cameras.lens import Lens


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
    import numpy as np
    import torch

    path = find_image(photo.path)
    pixels, alpha = decoder.read(path), decoder.read_alpha(path)
    height, width = pixels.shape[:2]
    distorted = photo.lens.resized(width, height, photo.where)
    lens, pixels = undistort(distorted, pixels, photo.where)
    mask = None
    if photo.mask is not None:
        _, white = undistort(distorted, read_mask(photo.mask, (width, height)), photo.where)
        mask = torch.from_numpy(white == 255)
    if alpha is not None:
        _, alpha = undistort(distorted, alpha, photo.where)
    return View(
        name=photo.name,
        camera=lens.camera(photo.world_to_camera, photo.where),
        image=torch.from_numpy(pixels.astype(np.float32) / 255),
        mask=mask,
        alpha=None if alpha is None else torch.from_numpy(alpha.astype(np.float32) / 255),
    )
