"""Read the three files of a COLMAP model, binary or text.

COLMAP's own reader accepts truncated files, NaN and rotations of any norm. This one checks each count
against the length of the file. Binary layout, little-endian:

    cameras.bin   u64 n, n x (i32 id, i32 model, u64 width, u64 height, f64 parameters)
    images.bin    u64 n, n x (i32 id, 7 f64 pose, i32 camera, name, 0, u64 m, m x (2 f64, i64))
    points3D.bin  u64 n, n x (u64 id, 3 f64 position, 3 u8 color, f64 error, u64 m, m x (2 i32))

The text files hold the same numbers, one record per line; lines that start with # are comments. In
`images.txt` a second line has the features, which some programs leave out.
"""

from __future__ import annotations

import struct
from contextlib import suppress
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from .lens import Distortion
from .reading import decoded

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray


class CameraModel(NamedTuple):
    """Number of parameters and of focal lengths among them, and the distortion of `Lens`."""

    parameters: int
    focal_lengths: int
    distortion: Distortion


CAMERA_MODELS = {
    "SIMPLE_PINHOLE": CameraModel(3, 1, "PINHOLE"),
    "PINHOLE": CameraModel(4, 2, "PINHOLE"),
    "SIMPLE_RADIAL": CameraModel(4, 1, "OPENCV"),
    "RADIAL": CameraModel(5, 1, "OPENCV"),
    "OPENCV": CameraModel(8, 2, "OPENCV"),
    "OPENCV_FISHEYE": CameraModel(8, 2, "OPENCV_FISHEYE"),
    "FULL_OPENCV": CameraModel(12, 2, "FULL_OPENCV"),
    "FOV": CameraModel(5, 2, "FOV"),
    "SIMPLE_RADIAL_FISHEYE": CameraModel(4, 1, "OPENCV_FISHEYE"),
    "RADIAL_FISHEYE": CameraModel(5, 1, "OPENCV_FISHEYE"),
    "THIN_PRISM_FISHEYE": CameraModel(12, 2, "THIN_PRISM_FISHEYE"),
    "SIMPLE_FISHEYE": CameraModel(3, 1, "OPENCV_FISHEYE"),
    "FISHEYE": CameraModel(4, 2, "OPENCV_FISHEYE"),
}
"""The supported camera models. The radial models are those with more coefficients, the others 0, and so are
the fisheyes without coefficients."""
_MODEL_NAMES = (
    *list(CAMERA_MODELS)[:11],
    *("RAD_TAN_THIN_PRISM_FISHEYE", "SIMPLE_DIVISION", "DIVISION"),
    *("SIMPLE_FISHEYE", "FISHEYE", "EUCM", "EQUIRECTANGULAR"),
)
"""COLMAP's camera models, in the order of their ids (COLMAP 4.2)."""
_PANORAMA = _MODEL_NAMES[-1]


class ColmapCamera(NamedTuple):
    """A camera: model name, size in pixels, parameters in COLMAP's order."""

    model: str
    width: int
    height: int
    parameters: tuple[float, ...]


class ColmapImage(NamedTuple):
    """A registered photograph: quaternion `(w, x, y, z)` and translation of world-to-camera."""

    quaternion: tuple[float, float, float, float]
    translation: tuple[float, float, float]
    camera_id: int
    name: str

    @property
    def world_to_camera(self) -> NDArray[np.float64]:
        """The pose `[4, 4]`, OpenCV axes."""
        import numpy as np
        from scipy.spatial.transform import Rotation

        result = np.eye(4)
        result[:3, :3] = Rotation.from_quat(self.quaternion, scalar_first=True).as_matrix()
        result[:3, 3] = self.translation
        return result


class ColmapPoint(NamedTuple):
    """A point: position `(x, y, z)`, color 0..255, and the ids of the images that observe it."""

    position: tuple[float, float, float]
    color: tuple[int, int, int]
    image_ids: list[int]


Record = TypeVar("Record", ColmapCamera, ColmapImage, ColmapPoint)
_FILES = ("cameras.bin", "images.bin", "points3D.bin")


_PLACES = ("sparse", "colmap/sparse", "dense/sparse", "dense/0/sparse", "")
"""Where programs write models, in a scene's folder."""
_DEEPEST = 3
"""Levels of folders below a scene's in which models are searched, if they are in no usual place."""


def has_colmap_model(folder: Path) -> bool:
    """Return whether a folder holds a COLMAP model, binary or text."""
    return any((folder / f"images{suffix}").is_file() for suffix in (".bin", ".txt"))


def _is_model(folder: Path) -> bool:
    """Return whether a folder holds a model, or what is left of a binary one."""
    return has_colmap_model(folder) or (folder / "cameras.bin").is_file()


def colmap_models(scene: Path, *, anywhere: bool = True) -> list[Path]:
    """Return the folders of the COLMAP models in a scene's folder, complete or not, the usual place first.

    Args:
        anywhere: search other folders, three levels deep, if the usual places have none.
    """
    numbered = [
        folder
        for place in _PLACES[:-1]
        for folder in sorted((scene / place).glob("[0-9]*"))
        if folder.is_dir()
    ]
    folders = [*numbered, *(scene / place for place in _PLACES)]
    found = [folder for folder in folders if _is_model(folder)]
    return found if found or not anywhere else [*_models_below(scene, _DEEPEST)]


def _models_below(folder: Path, levels: int) -> Iterator[Path]:
    children: list[Path] = []
    if levels and folder.is_dir():
        with suppress(PermissionError):
            children = sorted(folder.iterdir())
    for child in children:
        if child.is_dir() and not (child.is_symlink() or child.name.startswith(".")):
            if _is_model(child):
                yield child
            yield from _models_below(child, levels - 1)


def count_images(folder: Path) -> int:
    """Return the number of images of a model; 0 if they cannot be read."""
    with suppress(ValueError, OSError):
        binary = folder / "images.bin"
        if binary.is_file():
            return _Cursor(binary.read_bytes()).count(smallest=73)
        return sum(1 for _ in _text_images(folder / "images.txt"))
    return 0


def read_colmap_files(
    folder: Path,
) -> tuple[dict[int, ColmapCamera], dict[int, ColmapImage], dict[int, ColmapPoint]]:
    """Read cameras, images and points by id; there are no points without their file.

    Raises:
        ValueError: The layout is wrong, or a camera model is not supported.
    """
    binary, text = ((folder / f"images{suffix}").is_file() for suffix in (".bin", ".txt"))
    if text and not binary:
        suffix, parsers = ".txt", (_text_cameras, _text_images, _text_points)
    else:
        suffix, parsers = ".bin", (_binary_cameras, _binary_images, _binary_points)
    cameras, images, points = ((folder / name).with_suffix(suffix) for name in _FILES)
    return (
        _by_id(parsers[0](cameras)),
        _by_id(parsers[1](images)),
        _by_id(parsers[2](points)) if points.is_file() else {},
    )


def _by_id(records: Iterator[tuple[int, Record]]) -> dict[int, Record]:
    found: dict[int, Record] = {}
    for identity, record in records:
        if identity in found:
            raise ValueError(f"two records have the id {identity}")
        found[identity] = record
    return found


def _binary_cameras(path: Path) -> Iterator[tuple[int, ColmapCamera]]:
    for cursor in _records(path, smallest=24):
        identity, number, width, height = cursor.take("<2i2Q")
        model = _MODEL_NAMES[number] if 0 <= number < len(_MODEL_NAMES) else str(number)
        parameters = cursor.take(f"<{_parameter_count(model)}d")
        yield identity, ColmapCamera(model, width, height, parameters)


def _binary_images(path: Path) -> Iterator[tuple[int, ColmapImage]]:
    for cursor in _records(path, smallest=73):
        identity, w, x, y, z, t_x, t_y, t_z, camera_id = cursor.take("<i7di")
        name = cursor.text()
        cursor.skip(cursor.count(smallest=24) * 24)
        yield identity, ColmapImage((w, x, y, z), (t_x, t_y, t_z), camera_id, name)


def _binary_points(path: Path) -> Iterator[tuple[int, ColmapPoint]]:
    import numpy as np

    for cursor in _records(path, smallest=51):
        identity, x, y, z, red, green, blue, _error = cursor.take("<Q3d3Bd")
        track = np.frombuffer(cursor.skip(cursor.count(smallest=8) * 8), dtype="<i4")
        yield identity, ColmapPoint((x, y, z), (red, green, blue), track[::2].tolist())


def _records(path: Path, smallest: int) -> Iterator[_Cursor]:
    """Yield a cursor at each record, which has at least `smallest` bytes."""
    cursor = _Cursor(path.read_bytes())
    for _ in range(cursor.count(smallest)):
        yield cursor
    if cursor.left:
        raise ValueError(f"{cursor.left} bytes follow its last record")


def _text_cameras(path: Path) -> Iterator[tuple[int, ColmapCamera]]:
    for line in filter(None, _lines(path)):
        identity, model, width, height, *rest = _fields(line, at_least=4)
        count = _parameter_count(model)
        if len(rest) != count:
            raise ValueError(f"a camera {model} has {count} parameters, this one has {len(rest)}")
        parameters = tuple(float(value) for value in rest)
        yield int(identity), ColmapCamera(model, _whole(width), _whole(height), parameters)


def _text_images(path: Path) -> Iterator[tuple[int, ColmapImage]]:
    lines = [*_lines(path)]
    position = 0
    while position < len(lines):
        line, following = lines[position], [*lines[position + 1 : position + 2], ""][0]
        position += 1
        if not line:
            continue
        identity, *pose, camera_id, name = _fields(line, at_least=10, at_most=10)
        w, x, y, z, t_x, t_y, t_z = (float(value) for value in pose)
        yield int(identity), ColmapImage((w, x, y, z), (t_x, t_y, t_z), int(camera_id), name)
        if _are_features(following):
            position += 1
        elif len(following.split()) < 10:
            raise ValueError("a feature has 3 numbers; a line of features is incomplete")


def _are_features(line: str) -> bool:
    """Return whether a line holds the features of an image: x, y and a point's id each, or nothing.

    The next image in a file without features has a fraction, of its rotation, in place of the first id, or
    a name in place of a number.
    """
    fields = line.split()
    try:
        [float(field) for field in fields]
        [int(identity) for identity in fields[2::3]]
    except ValueError:
        return False
    return len(fields) % 3 == 0


def _text_points(path: Path) -> Iterator[tuple[int, ColmapPoint]]:
    for line in filter(None, _lines(path)):
        identity, x, y, z, red, green, blue, _error, *track = _fields(line, at_least=8)
        if len(track) % 2:
            raise ValueError("a track ends in the middle of an observation")
        color = (_whole(red), _whole(green), _whole(blue))
        if not all(0 <= channel <= 255 for channel in color):
            raise ValueError(f"the color {color} is not within 0..255")
        image_ids = [int(image) for image in track[::2]]
        yield int(identity), ColmapPoint((float(x), float(y), float(z)), color, image_ids)


def _lines(path: Path) -> Iterator[str]:
    for line in decoded(path.read_bytes()).split("\n"):
        if not line.strip().startswith("#"):
            yield line.strip()


def _fields(line: str, at_least: int, at_most: int = 0) -> list[str]:
    """Split a line; the last of `at_most` fields may contain spaces."""
    fields = line.split(maxsplit=at_most - 1)
    if len(fields) < at_least:
        raise ValueError(f"a record has at least {at_least} fields, this one has {len(fields)}")
    return fields


def _whole(number: str) -> int:
    """Return a size or colour, which some programs write as 270.0."""
    value = float(number)
    if value != int(value):
        raise ValueError(f"{number} is not a whole number")
    return int(value)


def _parameter_count(model: str) -> int:
    if model not in CAMERA_MODELS:
        remedy = "`colmap image_undistorter` writes a model that is"
        if model == _PANORAMA:
            remedy = "cut the panoramas into plane pictures before COLMAP"
        raise ValueError(
            f"the camera model {model} is not one of {', '.join(CAMERA_MODELS)}; {remedy}"
        )
    return CAMERA_MODELS[model].parameters


class _Cursor:
    def __init__(self, data: bytes) -> None:
        self._data, self._position = data, 0

    @property
    def left(self) -> int:
        return len(self._data) - self._position

    def take(self, layout: str) -> tuple[Any, ...]:
        return struct.unpack(layout, self.skip(struct.calcsize(layout)))

    def skip(self, size: int) -> bytes:
        if size > self.left:
            raise ValueError(f"it ends at byte {len(self._data)}, in the middle of a record")
        self._position += size
        return self._data[self._position - size : self._position]

    def count(self, smallest: int) -> int:
        """Read the number of records that follow, each at least `smallest` bytes long."""
        number: int = self.take("<Q")[0]
        if number * smallest > self.left:
            raise ValueError(f"it claims {number} records, which it is too short for")
        return number

    def text(self) -> str:
        end = self._data.find(b"\0", self._position)
        if end < 0:
            raise ValueError("it ends in the middle of a name")
        return self.skip(end + 1 - self._position)[:-1].decode()
