"""`nerfstudio`: a capture in nerfstudio's format, `transforms.json` (Tancik et al. 2023).

Lens fields are at the top level for all frames, or in a frame. Poses are camera-to-world with OpenGL axes.
The world is that of the file: `applied_transform`, which relates it to COLMAP's, is not undone, because the
points of `ply_file_path` have it applied too.
"""

from __future__ import annotations

import logging
import math
from collections import Counter
from pathlib import Path
from typing import Annotated, ClassVar

import pydantic
from pydantic import Field

from registry import Fact, PointCloud, Register, Scene, SceneError, SceneLoader, hookimpl
from registry.toolkit.photos import (
    Decoder,
    Distortion,
    Finite,
    Lens,
    LoadedPhotos,
    PosedPhoto,
    PoseMatrix,
    ResizeFilter,
    SplitSettings,
    divided_by,
    estimate_bounds,
    find_image,
    find_masks,
    inside,
    pose_from_opengl,
    read_document,
    stored_size,
    usable_photos,
    view_names,
)

_FIX = "write transforms.json as nerfstudio's ns-process-data does"
_FISHEYE, _PANORAMA = "OPENCV_FISHEYE", "EQUIRECTANGULAR"
_CAMERA_MODELS = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", _FISHEYE)
_COEFFICIENTS = ("k1", "k2", "k3", "k4", "p1", "p2")
_log = logging.getLogger("stereogs.photos")


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
    masks: bool = True
    """Exclude pixels where the image of `mask_path` is black from training and scores. If no frame has one,
    the mask of images/a.jpg is a.jpg.png or a.png in masks."""


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
        all_photos = _photos(folder, path, transforms, settings.masks)
        kept = usable_photos(all_photos, str(path))
        names = [all_photos[index].path.relative_to(folder).as_posix() for index in kept]
        train, test, rule = self._split(transforms, names, folder, str(path))
        train, test = [kept[k] for k in train], [kept[k] for k in test]
        photos = [all_photos[index] for index in train + test]
        decoder = Decoder(
            divided_by(settings.downsample, settings.max_size), settings.resize_filter
        )
        loaded = LoadedPhotos.load(photos, decoder, train, test)
        loaded.report_transparency()
        points = _read_points(folder, transforms, path) if settings.points else None
        if transforms.ply_file_path and not settings.points:
            _log.info(
                "the points of %s are not used; `points: true` uses them", transforms.ply_file_path
            )
        bounds = estimate_bounds(loaded.training_cameras, points, str(path))
        seen_by = Fact("points_seen_by", "all photographs" if points else "none")
        facts = (*loaded.split_facts(rule, len(all_photos)), seen_by)
        return loaded.scene("nerfstudio", folder, bounds, points, facts)

    def _split(
        self, transforms: _Transforms, names: list[str], folder: Path, where: str
    ) -> tuple[list[int], list[int], str]:
        """Return the indices of training and test views among the sorted names, and the rule.

        The test views are those of `test_filenames`, else of `val_filenames`, else all that do not train.
        """
        settings = self.settings
        lists = {
            kind: None if listed is None else [_relative(folder, name, where) for name in listed]
            for kind, listed in transforms.split_lists.items()
        }
        if settings.test_every == 0 or not any(lists.values()):
            return settings.split(len(names), where)
        known = {_relative(folder, frame.file_path, where) for frame in transforms.frames}
        for listed in filter(None, lists.values()):
            wrong = [f"{name!r}, which is not a frame" for name in listed if name not in known]
            wrong += [f"{name!r} twice" for name, count in Counter(listed).items() if count > 1]
            if wrong:
                fix = "correct the lists, or ignore them with `test_every: 0`"
                raise SceneError(f"the split lists {wrong[0]}", where=where, fix=fix)
        tested = lists["test"] if lists["test"] is not None else lists["val"]
        trained = lists["train"]
        if trained is None:
            trained = [name for name in names if name not in (tested or ())]
        if tested is None:
            tested = [name for name in names if name not in trained]
        if both := sorted({*trained} & {*tested}):
            fix = "remove it from one of the lists"
            raise SceneError(f"{both[0]!r} is a training and a test view", where=where, fix=fix)
        index = {name: k for k, name in enumerate(names)}  # without those that are left out
        train = settings.chosen(sorted(index[name] for name in trained if name in index), where)
        test = [index[name] for name in tested if name in index]
        _log.info("the file's split: %d photographs train, %d test", len(train), len(test))
        return train, test, "the file's, evenly spaced"


class _LensFields(pydantic.BaseModel):
    camera_model: str | None = None
    is_fisheye: bool | None = None
    camera_angle_x: Annotated[Finite, Field(gt=0, lt=math.pi)] | None = None
    camera_angle_y: Annotated[Finite, Field(gt=0, lt=math.pi)] | None = None
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
    distortion_params: tuple[Finite, Finite, Finite, Finite, Finite, Finite] | None = None
    """k1 k2 k3 k4 p1 p2, instead of the fields of these names."""

    def value(self, name: str) -> float | None:
        """Return a number by name; None if the file has none."""
        if self.distortion_params is not None and name in _COEFFICIENTS:
            return self.distortion_params[_COEFFICIENTS.index(name)]
        found: float | None = getattr(self, name)
        return found


class _Frame(_LensFields):
    file_path: str
    transform_matrix: PoseMatrix
    mask_path: str | None = None


class _Transforms(_LensFields):
    frames: tuple[_Frame, ...]
    train_filenames: tuple[str, ...] | None = None
    val_filenames: tuple[str, ...] | None = None
    test_filenames: tuple[str, ...] | None = None
    ply_file_path: str | None = None

    @property
    def split_lists(self) -> dict[str, tuple[str, ...] | None]:
        """The lists of file names by split; None for those that the file lacks."""
        return {
            "train": self.train_filenames,
            "val": self.val_filenames,
            "test": self.test_filenames,
        }


def _lens_of(frame: _Frame, transforms: _Transforms, photo: Path, where: str) -> Lens:
    """Return the lens of a frame; its size is the photograph's if the file has none.

    Raises:
        SceneError: the camera model is not supported, the focal length is missing, or k4 is ambiguous.
    """

    def given(name: str) -> float | None:
        value = frame.value(name)
        return transforms.value(name) if value is None else value

    def focal(name: str, angle: str, side: float) -> float | None:
        value, field_of_view = given(name), given(angle)
        if value is None and field_of_view is not None:
            return side / 2 / math.tan(field_of_view / 2)
        return value

    def coefficients(*names: str) -> tuple[float, ...]:
        return tuple(given(name) or 0.0 for name in names)

    model: Distortion = "PINHOLE"
    distortion: tuple[float, ...] = ()
    kind = frame.camera_model or transforms.camera_model
    if kind is not None and kind.upper() not in _CAMERA_MODELS:
        fix = "undistort the photographs, and write their cameras as PINHOLE"
        if kind.upper() == _PANORAMA:
            fix = "cut the panoramas into plane pictures: ns-process-data --camera-type equirectangular"
        what = f"the camera model {kind!r} is not one of {', '.join(_CAMERA_MODELS)}"
        raise SceneError(what, where=where, fix=fix)
    # instant-ngp writes no model, but whether the lens is a fisheye.
    if (kind or "").upper() == _FISHEYE or (
        kind is None and (frame.is_fisheye or transforms.is_fisheye)
    ):
        model, distortion = "OPENCV_FISHEYE", coefficients("k1", "k2", "k3", "k4")
    else:  # nerfstudio applies coefficients whatever the name of the model
        if given("k4"):
            raise SceneError(
                "k4 is not 0: nerfstudio multiplies it by the eighth power of the radius, OpenCV uses it in "
                "a denominator",
                where=where,
                fix="set k4 to 0, or undistort the photographs beforehand",
            )
        model = "FULL_OPENCV"
        distortion = (*coefficients("k1", "k2", "p1", "p2", "k3"), 0.0, 0.0, 0.0)
    width, height, cx, cy = (given(name) for name in ("w", "h", "cx", "cy"))
    if width is None or height is None:
        width, height = stored_size(find_image(photo))
    focal_x = focal("fl_x", "camera_angle_x", width)
    focal_y = focal("fl_y", "camera_angle_y", height)
    if focal_x is None:
        focal_x = focal_y
    if focal_x is None:
        what = "the focal length is missing: 'fl_x', 'fl_y', 'camera_angle_x' or 'camera_angle_y'"
        raise SceneError(what, where=where, fix=_FIX)
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


def _relative(folder: Path, name: str, where: str) -> str:
    """Return the file's path within the folder: `images/a.png` for `./images/a.png`."""
    return inside(folder, name, where).relative_to(folder).as_posix()


def _photos(
    folder: Path, path: Path, transforms: _Transforms, with_masks: bool
) -> list[PosedPhoto]:
    """Return the photographs of all frames, sorted by file name."""
    relative = [
        _relative(folder, frame.file_path, f"{path}, frame {index}")
        for index, frame in enumerate(transforms.frames)
    ]
    if repeated := [name for name, count in Counter(relative).items() if count > 1]:
        what = f"{relative.count(repeated[0])} frames have the photograph {repeated[0]!r}"
        fix = "keep one frame for each photograph, with the right pose"
        raise SceneError(what, where=str(path), fix=fix)
    order = sorted(range(len(relative)), key=lambda index: relative[index])
    names = view_names([relative[index] for index in order])
    masks = _masks(folder, path, transforms, relative) if with_masks else [None] * len(relative)
    photos = []
    for index, name in zip(order, names, strict=True):
        frame, where = transforms.frames[index], f"{path}, frame {index}"
        file = folder / relative[index]
        photos.append(
            PosedPhoto(
                name=name,
                path=file,
                world_to_camera=pose_from_opengl(frame.transform_matrix, where),
                lens=_lens_of(frame, transforms, file, where),
                where=where,
                mask=masks[index],
                mask_trains=True,
            )
        )
    return photos


def _masks(
    folder: Path, path: Path, transforms: _Transforms, relative: list[str]
) -> list[Path | None]:
    """Return the mask of each frame: that of `mask_path`, or one with the photograph's name."""
    if not any(frame.mask_path for frame in transforms.frames):
        return find_masks(folder, [folder / name for name in relative])
    return [
        inside(folder, frame.mask_path, f"{path}, frame {index}") if frame.mask_path else None
        for index, frame in enumerate(transforms.frames)
    ]


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
