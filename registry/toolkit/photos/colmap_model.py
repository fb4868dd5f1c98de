"""A consistent COLMAP model: cameras, photographs sorted by name, points with their tracks.

Point positions were estimated from all photographs, including test views. Points that the training views
observe carry less of that knowledge, but not none. The `sfm` initializer with `source: triangulate` uses
the training photographs only.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

from ...contract.scene import PointCloud
from ...errors import SceneError
from .colmap_files import (
    CAMERA_MODELS,
    ColmapCamera,
    ColmapImage,
    ColmapPoint,
    read_colmap_files,
)
from .lens import COEFFICIENTS, Lens
from .reading import decoding

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

MIN_TRAINING_OBSERVATIONS = 2
"""A point needs two training views: it could have been triangulated from them, but not from one."""
_log = logging.getLogger("stereogs.photos")
POINTS_FIX = "restore the file, or set `points: false` to continue without it"


@dataclass(frozen=True)
class Tracks:
    """Points and the photographs that observe them.

    Args:
        positions: `[P, 3]` world units.
        colors: `[P, 3]` 0..255.
        lengths: `[P]` number of observations per point.
        images: `[sum of lengths]` 0-based indices of sorted photographs, track after track.
    """

    positions: NDArray[np.float64]
    colors: NDArray[np.uint8]
    lengths: NDArray[np.int64]
    images: NDArray[np.int64]

    def seen_by(self, training: list[int]) -> PointCloud | None:
        """Return the points that at least two of the training views observe; None if there are none.

        Points without tracks, which some programs write, are used all.
        """
        import numpy as np

        if len(self.lengths) and not len(self.images):
            _log.warning(
                "the %d points do not say which photographs observe them; all are used, also those that only "
                "test views show",
                len(self.lengths),
            )
            return self._cloud(np.ones(len(self.lengths), dtype=bool))
        owner = np.repeat(np.arange(len(self.lengths)), self.lengths)
        pairs = np.unique(np.stack([owner, self.images])[:, np.isin(self.images, training)], axis=1)
        seen = np.bincount(pairs[0], minlength=len(self.lengths))
        keep = seen >= min(MIN_TRAINING_OBSERVATIONS, len(training))
        return self._cloud(keep) if keep.any() else None

    def _cloud(self, keep: NDArray[np.bool_]) -> PointCloud:
        import numpy as np
        import torch

        return PointCloud(
            positions=torch.from_numpy(self.positions[keep]),
            colors=torch.from_numpy(self.colors[keep].astype(np.float32) / 255),
        )

    def check(self, image_count: int, where: str) -> None:
        """Refuse inconsistent tracks.

        Raises:
            SceneError: Shapes, lengths or image indices are inconsistent, or a position is not finite.
        """
        import numpy as np

        count = len(self.lengths)
        problem = ""
        if self.positions.shape != (count, 3) or self.colors.shape != (count, 3):
            shapes = f"positions {self.positions.shape}, colors {self.colors.shape}"
            problem = f"{shapes} and track lengths {self.lengths.shape} do not match"
        elif self.lengths.ndim != 1 or self.images.ndim != 1:
            problem = f"the tracks have shape {self.images.shape}, not one dimension"
        elif (self.lengths < 0).any() or self.lengths.sum() != len(self.images):
            total, entries = self.lengths.sum(), len(self.images)
            problem = f"the track lengths add up to {total}, but the tracks have {entries} entries"
        elif len(self.images) and not 0 <= self.images.min() <= self.images.max() < image_count:
            problem = f"a track names an image that is not one of the {image_count}"
        elif not np.isfinite(self.positions).all():
            row = int(np.flatnonzero(~np.isfinite(self.positions).all(axis=1))[0])
            problem = f"point {row} is not finite"
        if problem:
            raise SceneError(
                f"the points file is inconsistent: {problem}", where=where, fix=POINTS_FIX
            )


@dataclass(frozen=True)
class ColmapModel:
    """The content of a model's folder; `images` holds ids and photographs, sorted by name."""

    cameras: dict[int, ColmapCamera]
    images: list[tuple[int, ColmapImage]]
    points: list[ColmapPoint]
    folder: Path

    def lens(self, image: ColmapImage) -> Lens:
        """Return the lens of a photograph; simple and radial models get two focal lengths."""
        camera = self.cameras[image.camera_id]
        model, values = CAMERA_MODELS[camera.model], camera.parameters
        if model.focal_lengths == 1:
            values = (values[0], *values)
        fx, fy, cx, cy, *rest = values
        rest += [0.0] * (COEFFICIENTS[model.distortion] - len(rest))
        return Lens(fx, fy, cx, cy, camera.width, camera.height, model.distortion, tuple(rest))

    def tracks(self) -> Tracks:
        """Return the points with their tracks; image indices follow the order of the names.

        Without points in COLMAP's files, those of points3D.ply, which 3DGS and others write, without tracks.
        """
        import numpy as np

        cloud = self.folder / "points3D.ply"
        if not self.points and cloud.is_file():
            from core_rasterizer import load_points

            found, colors = (values.double().numpy() for values in load_points(cloud))
            none = np.zeros(0, dtype=np.int64)
            return Tracks(
                found, np.rint(255 * colors).astype(np.uint8), np.zeros(len(found), np.int64), none
            )
        index = {identity: k for k, (identity, _) in enumerate(self.images)}
        images = [index[identity] for point in self.points for identity in point.image_ids]
        positions = np.array([p.position for p in self.points], dtype=np.float64).reshape(-1, 3)
        return Tracks(
            positions=positions,
            colors=np.array([p.color for p in self.points], dtype=np.uint8).reshape(-1, 3),
            lengths=np.array([len(p.image_ids) for p in self.points], dtype=np.int64),
            images=np.array(images, dtype=np.int64),
        )


def read_colmap_model(folder: Path, fix: str) -> ColmapModel:
    """Read a model; prefer binary files over text files.

    Raises:
        SceneError: A file is missing or damaged, a number is not finite, a quaternion does not have
            norm 1, or a record refers to a missing camera or image.
    """
    if all((folder / f"images{suffix}").is_file() for suffix in (".bin", ".txt")):
        _log.info("%s has binary and text files; the binary ones are used", folder)
    with decoding("the COLMAP model", folder, fix):
        cameras, images, points = read_colmap_files(folder)
    by_name = sorted(images.items(), key=lambda item: item[1].name)
    by_id = [points[identity] for identity in sorted(points)]
    model = ColmapModel(cameras, by_name, by_id, folder)
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
            return f"image {image.name!r} has camera {image.camera_id}, which is missing"
        if not np.isfinite([*image.quaternion, *image.translation]).all():
            return f"the pose of image {image.name!r} is not finite"
        norm = float(np.linalg.norm(image.quaternion))
        if abs(norm - 1) > 1e-3:
            return f"the rotation of image {image.name!r} has a norm of {norm:g}, not 1"
    for number, point in enumerate(model.points):
        if not np.isfinite(point.position).all():
            return f"point {number} is not finite"
        if not known.issuperset(point.image_ids):
            return f"point {number} is observed by a missing image"
    return ""
