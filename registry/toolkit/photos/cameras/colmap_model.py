"""A COLMAP model whose parts fit together: cameras, photographs sorted by name, points."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

from ....errors import SceneError
from ..reading import decoding
from .colmap_files import (
    ColmapCamera,
    ColmapImage,
    ColmapPoint,
    read_cameras,
    read_images,
    read_points3d,
)
from .lens import Distortion, Lens
from .tracks import Tracks

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

_BINARY = ("cameras.bin", "images.bin", "points3D.bin")
_TEXT = ("cameras.txt", "images.txt", "points3D.txt")
_ONE_FOCAL_LENGTH = ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
_DISTORTION: dict[str, Distortion] = {
    "SIMPLE_PINHOLE": "PINHOLE",
    "PINHOLE": "PINHOLE",
    "SIMPLE_RADIAL": "OPENCV",
    "RADIAL": "OPENCV",
    "OPENCV": "OPENCV",
    "OPENCV_FISHEYE": "OPENCV_FISHEYE",
    "FULL_OPENCV": "FULL_OPENCV",
}


@dataclass(frozen=True)
class ColmapModel:
    """What a model's folder holds.

    Args:
        images: registered photographs with their ids, sorted by name.
    """

    cameras: dict[int, ColmapCamera]
    images: list[tuple[int, ColmapImage]]
    points: list[ColmapPoint]
    folder: Path

    def lens(self, image: ColmapImage) -> Lens:
        """The lens of a photograph. All pinhole and radial models become ones with two focal lengths."""
        camera = self.cameras[image.camera_id]
        values = camera.parameters
        if camera.model in _ONE_FOCAL_LENGTH:
            values = (values[0], *values)
        fx, fy, cx, cy, *rest = values
        model = _DISTORTION[camera.model]
        if model == "OPENCV":
            rest += [0.0] * (4 - len(rest))
        return Lens(fx, fy, cx, cy, camera.width, camera.height, model, tuple(rest))

    def tracks(self) -> Tracks:
        """The points with their tracks; images are counted in the order of their names."""
        import numpy as np

        index = {identity: k for k, (identity, _) in enumerate(self.images)}
        images = [index[identity] for point in self.points for identity in point.image_ids]
        return Tracks(
            positions=_single([p.position for p in self.points]),
            colors=np.array([p.color for p in self.points], dtype=np.uint8).reshape(-1, 3),
            lengths=np.array([len(p.image_ids) for p in self.points], dtype=np.int64),
            images=np.array(images, dtype=np.int64),
        )


def has_colmap_model(folder: Path) -> bool:
    """Whether a folder holds a COLMAP model, binary or text."""
    return any((folder / f"images{suffix}").is_file() for suffix in (".bin", ".txt"))


def read_colmap_model(folder: Path, fix: str) -> ColmapModel:
    """Read a model; of binary and text, binary if it is there.

    Raises:
        SceneError: a file is missing or damaged, a number is not finite, a rotation is none, or
            something refers to a camera or image that does not exist.
    """
    names = _BINARY if (folder / _BINARY[1]).is_file() else _TEXT
    with decoding("the COLMAP model", folder, fix):
        cameras, images, points = (folder / name for name in names)
        model = ColmapModel(
            read_cameras(cameras),
            sorted(read_images(images).items(), key=lambda item: item[1].name),
            read_points3d(points) if points.is_file() else [],
            folder,
        )
    problem = _problem(model)
    if problem:
        raise SceneError(f"the COLMAP model is inconsistent: {problem}", where=str(folder), fix=fix)
    return model


def _problem(model: ColmapModel) -> str:
    import numpy as np

    if not model.images:
        return "it has no registered image"
    names = [image.name for _, image in model.images]
    known = {identity for identity, _ in model.images}
    for name, following in pairwise(names):
        if name == following:
            return f"two images are named {name!r}"
    for _, image in model.images:
        if image.camera_id not in model.cameras:
            return f"image {image.name!r} has camera {image.camera_id}, which is not there"
        if not np.isfinite([*image.quaternion, *image.translation]).all():
            return f"the pose of image {image.name!r} is not finite"
        norm = float(np.linalg.norm(image.quaternion))
        if abs(norm - 1) > 1e-3:
            return f"the rotation of image {image.name!r} has a norm of {norm:g}, not 1"
    for number, point in enumerate(model.points):
        if not np.isfinite(point.position).all():
            return f"point {number} is not finite"
        if not known.issuperset(point.image_ids):
            return f"point {number} is seen by an image that is not there"
    return ""


def _single(positions: list[tuple[float, float, float]]) -> NDArray[np.float32]:
    import numpy as np

    with np.errstate(over="ignore"):  # an overflow becomes infinite and is refused
        return np.array(positions, dtype=np.float64).reshape(-1, 3).astype(np.float32)
