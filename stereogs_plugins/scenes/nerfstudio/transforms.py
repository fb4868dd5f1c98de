"""The camera file of nerfstudio, `transforms.json`, and the lens that it describes for each frame.

Lens fields stand at the top for all frames or in a frame for itself. Poses are camera-to-world with
OpenGL axes. The world is that of the file: `applied_transform` says how it came from COLMAP's, and is
not taken back, for the points of `ply_file_path` went through it too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import pydantic

from registry import SceneError
from registry.toolkit.photos import Distortion, Finite, Lens, Matrix4x4, MatrixRow, read_document

if TYPE_CHECKING:
    from pathlib import Path

FIX = "write transforms.json as nerfstudio's ns-process-data does"


class LensFields(pydantic.BaseModel):
    """Lens fields, of a frame or of the whole file."""

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


class Frame(LensFields):
    """One photograph: its file, its camera-to-world matrix, and an optional mask file."""

    file_path: str
    transform_matrix: Matrix4x4
    mask_path: str | None = None


class Transforms(LensFields):
    """The whole file, as far as it is used."""

    frames: tuple[Frame, ...]
    train_filenames: tuple[str, ...] | None = None
    test_filenames: tuple[str, ...] | None = None
    ply_file_path: str | None = None
    applied_transform: tuple[MatrixRow, MatrixRow, MatrixRow] | None = None


def read_transforms(path: Path) -> Transforms:
    """Read the file.

    Raises:
        SceneError: it is missing, damaged, or has a field that is not what it should be.
    """
    transforms = read_document(path, Transforms, FIX)
    if not transforms.frames:
        raise SceneError("the camera file has no frame", where=str(path), fix=FIX)
    return transforms


def lens_of(frame: Frame, transforms: Transforms, where: str) -> Lens:
    """The lens of a frame.

    Raises:
        SceneError: a focal length or size is missing, or the distortion has a k4 that two programs
            would read in two ways.
    """

    def given(name: str) -> float | None:
        value = getattr(frame, name)
        found: float | None = getattr(transforms, name) if value is None else value
        return found

    def needed(name: str) -> float:
        value = given(name)
        if value is None:
            raise SceneError(f"the field {name!r} is missing", where=where, fix=FIX)
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
                "k4 is not 0: for nerfstudio it belongs to the eighth power of the radius, for "
                "OpenCV to a denominator",
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
