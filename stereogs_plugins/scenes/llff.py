"""`llff`: captures with `poses_bounds.npy` (Mildenhall et al. 2019), also Mip-NeRF 360 in this format.

Each row of `poses_bounds.npy` has 17 numbers: a row-major 3x5 matrix `[R | t | (height, width, focal)]`, and
the near and far depth of the view's content. `[R | t]` is camera-to-world with camera axes (down, right,
backwards); height, width and focal length are those of the full-size photograph. Rows are in the order of the
sorted file names.

If photographs were removed from a capture, `split.json` next to the poses lists the photograph of every row:
`{"all_names": ["first.jpg", ...]}`. The split is then that of the whole capture.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal

import pydantic
from pydantic import Field

from registry import PointCloud, Register, Scene, SceneError, SceneLoader, hookimpl
from registry.toolkit.photos import (
    POINTS_FIX,
    ImageSourceSettings,
    Lens,
    LoadedPhotos,
    PosedPhoto,
    SplitSettings,
    Tracks,
    decoding,
    estimate_bounds,
    has_colmap_model,
    inside,
    list_images,
    masks_beside,
    pose_from_axes,
    read_array,
    read_arrays,
    read_colmap_model,
    read_document,
)

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_FIX = "set `path` to the folder of one complete LLFF scene, for example .../llff_fern"
_ARRAYS = ("xyz", "rgb", "track_len", "track_image_ids")


class LLFFSettings(SplitSettings, ImageSourceSettings):
    path: Path
    """Path of the scene's folder with poses_bounds.npy and the photographs."""
    train_views: int | None = Field(3, ge=0)
    """Number of training views; null or 0 takes all photographs that are not test views."""
    test_every: int | None = Field(8, ge=0)
    """Every N-th photograph of the sorted list is a test view, starting with the first; 0 gives no test
    views. null means 8, and 0 for fewer than eight photographs."""
    bounds: Literal["file", "estimate"] = "file"
    """Source of the depth bounds: the file, or an estimate from points and cameras. Mip-NeRF 360 needs
    `estimate`, because its files have the same two numbers for every scene."""
    points: bool = True
    """Use those structure-from-motion points, if any, that the training views see."""
    masks: bool = True
    """Exclude pixels where a mask is black from training and scores. The mask of images_8/a.jpg is a.jpg.png
    or a.png in masks_8 or masks."""


class LLFFScene(SceneLoader[LLFFSettings]):
    """Loader of LLFF scenes: `poses_bounds.npy`, `images_N/` and, if present, points."""

    recognized_by: ClassVar[str] = "poses_bounds.npy"

    @classmethod
    def recognizes(cls, folder: Path) -> bool:
        """Return True if the folder contains poses_bounds.npy."""
        return (folder / "poses_bounds.npy").is_file()

    def load(self) -> Scene:
        """Return the scene.

        Raises:
            SceneError: a missing folder or file, different numbers of poses and images, an image of another
                size, a pose that is not finite, or too few photographs for `train_views`.
        """
        settings = self.settings
        folder = settings.path.expanduser()
        if not folder.is_dir():
            raise SceneError(
                "the scene's folder does not exist",
                where=str(folder),
                fix="set `path` to the folder with poses_bounds.npy",
            )
        rows = read_poses(folder / "poses_bounds.npy")
        image_folder = settings.image_folder(folder)
        images = _image_of_each_row(folder, image_folder, len(rows))
        masks = masks_beside(image_folder, images) if settings.masks else [None] * len(images)
        train, test, rule = settings.split(len(rows), str(folder))
        photos = [
            PosedPhoto(
                *(images[k].stem, images[k], rows[k].world_to_camera, rows[k].lens, rows[k].where),
                mask=masks[k],
                mask_trains=True,
            )
            for k in train + test
        ]
        loaded = LoadedPhotos.load(photos, settings.decoder(), train, test)
        loaded.report_transparency()
        loaded.require_one_size()
        points = read_points(folder, len(rows), train) if settings.points else None
        if settings.bounds == "estimate":
            bounds = estimate_bounds(loaded.training_cameras, points, str(folder))
        else:
            bounds = min(rows[k].near for k in train), max(rows[k].far for k in train)
        facts = loaded.split_facts(rule, len(rows))
        return loaded.scene("llff", folder, bounds, points, facts)


class _Split(pydantic.BaseModel):
    all_names: tuple[str, ...]


def _image_of_each_row(folder: Path, images: Path, row_count: int) -> list[Path]:
    """Paths in the order of the rows; some of those listed in `split.json` may not exist."""
    names = folder / "split.json"
    found = list_images(images)
    if names.is_file():
        fix = 'write {"all_names": [...]} with one name for each row, or remove the file'
        listed = read_document(names, _Split, fix).all_names
        found = [inside(images, name, str(names)) for name in listed]
    if len(found) != row_count:
        fix = "restore the missing images, or remove the rows of the missing images"
        stems = Counter(path.stem for path in found)
        if repeated := [path.name for path in found if stems[path.stem] > 1]:
            fix = f"remove the copies of photographs with another suffix: {', '.join(repeated[:6])}"
        raise SceneError(
            f"there are {row_count} poses but {len(found)} images",
            where=f"{folder / 'poses_bounds.npy'} and {names if names.is_file() else images}",
            fix=fix,
        )
    return found


@dataclass(frozen=True)
class PoseRow:
    """One row in the conventions of `Camera`.

    Args:
        world_to_camera: `[4, 4]` float64, camera axes (right, down, forward).
        lens: lens of the full-size photograph; principal point at its centre.
        near, far: z-depths, world units, 0 < near < far.
        where: file and row, for error messages.
    """

    world_to_camera: NDArray[np.float64]
    lens: Lens
    near: float
    far: float
    where: str


def read_poses(path: Path) -> list[PoseRow]:
    """Read all rows of a `poses_bounds.npy`.

    Raises:
        SceneError: the file is missing, unreadable or of another shape; or a row is not finite, has a size
            or focal length that is not positive, or depth bounds out of order.
    """
    import numpy as np

    rows = read_array(path, "the camera file poses_bounds.npy", _FIX)
    with decoding("the camera file", path, _FIX):
        rows = np.asarray(rows, dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] != 17 or not len(rows):
        raise SceneError(
            f"the camera file has shape {rows.shape}, expected (number of images, 17)",
            where=str(path),
            fix="check that this is the poses_bounds.npy of an LLFF scene",
        )
    return [_parse(row, f"{path}, row {index}") for index, row in enumerate(rows)]


def _parse(row: NDArray[np.float64], where: str) -> PoseRow:
    import numpy as np

    if not np.isfinite(row).all():
        column = int(np.flatnonzero(~np.isfinite(row))[0])
        raise SceneError(
            f"the pose contains {row[column]:g} in column {column}",
            where=where,
            fix="remove this photograph and its row, or estimate the poses again",
        )
    matrix = row[:15].reshape(3, 5)
    height, width, focal = (float(value) for value in matrix[:, 4])
    for name, value in (("height", height), ("width", width), ("focal length", focal)):
        if value <= 0:
            raise SceneError(
                f"the {name} is {value:g}; it must be positive",
                where=where,
                fix="check the file; a mirrored pose needs flipped axes, not a negative focal length",
            )
    near, far = row[15:]
    if not 0 < near < far:
        raise SceneError(
            f"the depth bounds are {near:g} .. {far:g}; they must satisfy 0 < near < far",
            where=where,
            fix="estimate the bounds again from the depths of the points in this view",
        )
    down, right, backwards, center = matrix[:, :4].T
    return PoseRow(
        world_to_camera=pose_from_axes(right, down, -backwards, center),
        lens=Lens(focal, focal, width / 2, height / 2, width, height),
        near=float(near),
        far=float(far),
        where=where,
    )


def read_points(folder: Path, image_count: int, training: list[int]) -> PointCloud | None:
    """Read the points that at least two training views see; None if the scene has no points.

    Reads `points3d.npz` if it exists, otherwise the COLMAP model in `sparse/0`.

    Args:
        folder: folder of the scene.
        image_count: number of photographs in the scene.
        training: indices of the training views in the sorted list of photographs.

    Raises:
        SceneError: a file of points exists but cannot be used.
    """
    archive, model = folder / "points3d.npz", folder / "sparse" / "0"
    if archive.is_file():
        path, tracks = archive, _read_archive(archive)
    elif has_colmap_model(model):
        path, tracks = model, _read_colmap(model, image_count)
    else:
        return None
    tracks.check(image_count, str(path))
    return tracks.seen_by(training)


def _read_archive(path: Path) -> Tracks:
    import numpy as np

    data = read_arrays(path, _ARRAYS, "the points file", POINTS_FIX)
    with decoding("the points file", path, POINTS_FIX):
        return Tracks(
            positions=np.asarray(data["xyz"], dtype=np.float64),
            colors=np.asarray(data["rgb"], dtype=np.uint8),
            lengths=np.asarray(data["track_len"], dtype=np.int64),
            images=np.asarray(data["track_image_ids"], dtype=np.int64) - 1,
        )


def _read_colmap(folder: Path, image_count: int) -> Tracks:
    model = read_colmap_model(folder, POINTS_FIX)
    if len(model.images) != image_count:
        raise SceneError(
            f"the COLMAP model has {len(model.images)} images, the scene has {image_count}",
            where=str(folder),
            fix=POINTS_FIX,
        )
    # Resized photographs may be renamed but not reordered, so the sorted lists correspond.
    return model.tracks()


@hookimpl
def stereogs_register_scenes(register: Register[LLFFScene]) -> None:
    register("llff", LLFFScene)
