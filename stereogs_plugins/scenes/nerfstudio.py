"""`nerfstudio`: a capture in nerfstudio's format, `transforms.json` (Tancik et al. 2023).

Lens fields are at the top level for all frames, or in a frame. Poses are camera-to-world with OpenGL axes.
The world is that of the file: `applied_transform`, which relates it to COLMAP's, is not undone, because the
points of `ply_file_path` have it applied too.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import ClassVar, Literal

import pydantic
from pydantic import Field

from registry import Fact, PointCloud, Register, Scene, SceneError, SceneLoader, hookimpl
from registry.toolkit.photos import (
    Decoder,
    Distortion,
    Finite,
    Lens,
    LoadedPhotos,
    Matrix4x4,
    MatrixRow,
    PosedPhoto,
    ResizeFilter,
    SplitSettings,
    divided_by,
    estimate_bounds,
    evenly_spaced,
    inside,
    pose_from_opengl,
    read_document,
    view_names,
)

_FIX = "write transforms.json as nerfstudio's ns-process-data does"


class NerfstudioSettings(SplitSettings):
    path: Path
    """Path of the scene's folder with transforms.json."""
    downsample: int = Field(1, ge=1)
    """Factor by which each side of the photographs is reduced."""
    resize_filter: ResizeFilter = "bicubic"
    """Pillow filter for resizing. Distorted photographs use `lanczos`."""
    max_size: int | None = Field(1600, ge=16)
    """Longer side of the photographs, at most, in pixels; larger ones are resized. 1600 as in 3DGS;
    null: no limit."""
    points: bool = False
    """Use the points of `ply_file_path`. They include points seen only by test views, so scores are not
    comparable with other methods."""


class NerfstudioScene(SceneLoader[NerfstudioSettings]):
    """Loader of `transforms.json`. Photographs are undistorted; the world is the file's."""

    recognized_by: ClassVar[str] = "transforms.json"

    @classmethod
    def recognizes(cls, folder: Path) -> bool:
        """Return True if the folder contains transforms.json."""
        return (folder / "transforms.json").is_file()

    def load(self) -> Scene:
        """Return the scene, with the split of the file if it has one and `test_every` is not 0.

        Raises:
            SceneError: a missing or damaged file, a field that is missing or not finite, or a photograph
                that is missing or differs in shape from its camera.
        """
        settings = self.settings
        folder = settings.path.expanduser()
        path = folder / "transforms.json"
        transforms = read_document(path, _Transforms, _FIX)
        if not transforms.frames:
            raise SceneError("the camera file has no frame", where=str(path), fix=_FIX)
        all_photos = _photos(folder, path, transforms)
        train, test, rule = self._split(transforms, str(path))
        photos = [all_photos[index] for index in train + test]
        decoder = Decoder(
            divided_by(settings.downsample, settings.max_size), settings.resize_filter
        )
        loaded = LoadedPhotos.load(photos, decoder, train, test)
        points = _read_points(folder, transforms, path) if settings.points else None
        bounds = estimate_bounds(loaded.training_cameras, points, str(path))
        seen_by = Fact("points_seen_by", "all photographs" if points else "none")
        facts = (*loaded.split_facts(rule, len(all_photos)), seen_by)
        return loaded.scene("nerfstudio", folder, bounds, points, facts)

    def _split(self, transforms: _Transforms, where: str) -> tuple[list[int], list[int], str]:
        """Indices into the frames, sorted by file name, and the rule behind them."""
        settings = self.settings
        names = sorted(frame.file_path for frame in transforms.frames)
        train_names, test_names = transforms.train_filenames, transforms.test_filenames
        if train_names is None or test_names is None or settings.test_every == 0:
            return settings.split(len(names), where)
        index = {name: k for k, name in enumerate(names)}
        listed = [*train_names, *test_names]
        wrong = [f"{name!r}, which is not a frame" for name in listed if name not in index]
        wrong += [f"{name!r} twice" for name, count in Counter(listed).items() if count > 1]
        pool = [index[name] for name in train_names if name in index]
        if wrong or (settings.train_views or 1) > len(pool):
            raise SceneError(
                f"the split lists {wrong[0]}"
                if wrong
                else f"`train_views` is {settings.train_views or 1}, but the file lists {len(pool)}",
                where=where,
                fix="correct train_filenames and test_filenames, or lower `train_views`",
            )
        train = evenly_spaced(sorted(pool), settings.train_views)
        return train, [index[name] for name in test_names], "the file's, evenly spaced"


class _LensFields(pydantic.BaseModel):
    camera_model: Literal["SIMPLE_PINHOLE", "PINHOLE", "OPENCV", "OPENCV_FISHEYE"] | None = None
    fl_x: Finite | None = None
    fl_y: Finite | None = None
    cx: Finite | None = None
    cy: Finite | None = None
    w: Finite | None = None
    h: Finite | None = None
    k1: Finite | None = None
    k2: Finite | None = None
    k3: Finite | None = None
    k4: Finite | None = None
    p1: Finite | None = None
    p2: Finite | None = None


class _Frame(_LensFields):
    file_path: str
    transform_matrix: Matrix4x4
    mask_path: str | None = None


class _Transforms(_LensFields):
    frames: tuple[_Frame, ...]
    train_filenames: tuple[str, ...] | None = None
    test_filenames: tuple[str, ...] | None = None
    ply_file_path: str | None = None
    applied_transform: tuple[MatrixRow, MatrixRow, MatrixRow] | None = None


def _lens_of(frame: _Frame, transforms: _Transforms, where: str) -> Lens:
    """Lens of a frame; raise SceneError if a focal length or size is missing, or k4 is ambiguous."""

    def given(name: str) -> float | None:
        value = getattr(frame, name)
        found: float | None = getattr(transforms, name) if value is None else value
        return found

    def needed(name: str) -> float:
        value = given(name)
        if value is None:
            raise SceneError(f"the field {name!r} is missing", where=where, fix=_FIX)
        return value

    def coefficients(*names: str) -> tuple[float, ...]:
        return tuple(given(name) or 0.0 for name in names)

    model: Distortion = "PINHOLE"
    distortion: tuple[float, ...] = ()
    kind = frame.camera_model or transforms.camera_model
    if kind == "OPENCV_FISHEYE":
        model, distortion = "OPENCV_FISHEYE", coefficients("k1", "k2", "k3", "k4")
    elif kind in (None, "OPENCV"):
        if given("k4"):
            raise SceneError(
                "k4 is not 0: nerfstudio multiplies it by the eighth power of the radius, OpenCV uses it in "
                "a denominator",
                where=where,
                fix="set k4 to 0, or undistort the photographs beforehand",
            )
        model = "FULL_OPENCV"
        distortion = (*coefficients("k1", "k2", "p1", "p2", "k3"), 0.0, 0.0, 0.0)
    focal_x, width, height = needed("fl_x"), needed("w"), needed("h")
    focal_y, cx, cy = given("fl_y"), given("cx"), given("cy")
    return Lens(
        fx=focal_x,
        fy=focal_x if focal_y is None else focal_y,
        cx=width / 2 if cx is None else cx,
        cy=height / 2 if cy is None else cy,
        width=width,
        height=height,
        model=model,
        distortion=distortion,
    )


def _photos(folder: Path, path: Path, transforms: _Transforms) -> list[PosedPhoto]:
    """Photographs of all frames, sorted by file name."""
    frames = sorted(enumerate(transforms.frames), key=lambda item: item[1].file_path)
    names = view_names([frame.file_path for _, frame in frames])
    photos = []
    for (index, frame), name in zip(frames, names, strict=True):
        where = f"{path}, frame {index}"
        photos.append(
            PosedPhoto(
                name=name,
                path=inside(folder, frame.file_path, where),
                world_to_camera=pose_from_opengl(frame.transform_matrix, where),
                lens=_lens_of(frame, transforms, where),
                where=where,
                mask=inside(folder, frame.mask_path, where) if frame.mask_path else None,
            )
        )
    return photos


def _read_points(folder: Path, transforms: _Transforms, path: Path) -> PointCloud | None:
    from core_rasterizer import load_points

    if transforms.ply_file_path is None:
        return None
    file = inside(folder, transforms.ply_file_path, str(path))
    positions, colors = load_points(file)
    return PointCloud(positions=positions, colors=colors) if len(positions) else None


@hookimpl
def stereogs_register_scenes(register: Register[NerfstudioScene]) -> None:
    register("nerfstudio", NerfstudioScene)
