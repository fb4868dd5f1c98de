"""Read the three files of a COLMAP model, binary or text.

COLMAP's own reader accepts truncated files, NaN and rotations of any norm. This one checks each count
against the length of the file. Binary layout, little-endian:

    cameras.bin   u64 n, n x (i32 id, i32 model, u64 width, u64 height, f64 parameters)
    images.bin    u64 n, n x (i32 id, 7 f64 pose, i32 camera, name, 0, u64 m, m x (2 f64, i64))
    points3D.bin  u64 n, n x (u64 id, 3 f64 position, 3 u8 color, f64 error, u64 m, m x (2 i32))

The text files hold the same numbers, one record per line (`images.txt`: two lines, the second with the
features); lines that start with # are comments.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

PARAMETERS = {
    "SIMPLE_PINHOLE": 3,
    "PINHOLE": 4,
    "SIMPLE_RADIAL": 4,
    "RADIAL": 5,
    "OPENCV": 8,
    "OPENCV_FISHEYE": 8,
    "FULL_OPENCV": 12,
}
"""Number of parameters of each supported camera model, in the order of COLMAP's model ids."""
_MODELS = list(PARAMETERS)


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


def read_cameras(path: Path) -> dict[int, ColmapCamera]:
    """Read cameras by id from cameras.bin or cameras.txt.

    Raises:
        ValueError: The layout is wrong, or a camera model is not supported.
    """
    return _by_id(_binary_cameras(path) if path.suffix == ".bin" else _text_cameras(path))


def read_images(path: Path) -> dict[int, ColmapImage]:
    """Read registered photographs by id from images.bin or images.txt.

    Raises:
        ValueError: The layout is wrong.
    """
    return _by_id(_binary_images(path) if path.suffix == ".bin" else _text_images(path))


def read_points3d(path: Path) -> list[ColmapPoint]:
    """Read all points, ordered by id, from points3D.bin or points3D.txt.

    Raises:
        ValueError: The layout is wrong.
    """
    points = _by_id(_binary_points(path) if path.suffix == ".bin" else _text_points(path))
    return [points[identity] for identity in sorted(points)]


def _by_id(records: Iterator[tuple[int, Record]]) -> dict[int, Record]:
    found: dict[int, Record] = {}
    for identity, record in records:
        if identity in found:
            raise ValueError(f"two records have the id {identity}")
        found[identity] = record
    return found


def _binary_cameras(path: Path) -> Iterator[tuple[int, ColmapCamera]]:
    cursor = _Cursor(path.read_bytes())
    for _ in range(cursor.count(smallest=24)):
        identity, number, width, height = cursor.take("<2i2Q")
        if not 0 <= number < len(_MODELS):
            raise ValueError(_unknown_model(number))
        model = _MODELS[number]
        parameters = cursor.take(f"<{PARAMETERS[model]}d")
        yield identity, ColmapCamera(model, width, height, parameters)
    cursor.end()


def _binary_images(path: Path) -> Iterator[tuple[int, ColmapImage]]:
    cursor = _Cursor(path.read_bytes())
    for _ in range(cursor.count(smallest=73)):
        identity, w, x, y, z, t_x, t_y, t_z, camera_id = cursor.take("<i7di")
        name = cursor.text()
        cursor.skip(cursor.count(smallest=24) * 24)
        yield identity, ColmapImage((w, x, y, z), (t_x, t_y, t_z), camera_id, name)
    cursor.end()


def _binary_points(path: Path) -> Iterator[tuple[int, ColmapPoint]]:
    import numpy as np

    cursor = _Cursor(path.read_bytes())
    for _ in range(cursor.count(smallest=51)):
        identity, x, y, z, red, green, blue, _error = cursor.take("<Q3d3Bd")
        track = np.frombuffer(cursor.skip(cursor.count(smallest=8) * 8), dtype="<i4")
        yield identity, ColmapPoint((x, y, z), (red, green, blue), track[::2].tolist())
    cursor.end()


def _text_cameras(path: Path) -> Iterator[tuple[int, ColmapCamera]]:
    for line in filter(None, _lines(path)):
        identity, model, width, height, *rest = _fields(line, at_least=4)
        if model not in PARAMETERS:
            raise ValueError(_unknown_model(model))
        if len(rest) != PARAMETERS[model]:
            raise ValueError(
                f"a camera {model} has {PARAMETERS[model]} parameters, this one has {len(rest)}"
            )
        parameters = tuple(float(value) for value in rest)
        yield int(identity), ColmapCamera(model, int(width), int(height), parameters)


def _text_images(path: Path) -> Iterator[tuple[int, ColmapImage]]:
    remaining = _lines(path)
    for line in filter(None, remaining):
        identity, *pose, camera_id, name = _fields(line, at_least=10, at_most=10)
        w, x, y, z, t_x, t_y, t_z = (float(value) for value in pose)
        features = next(remaining, "").split()
        if len(features) % 3:
            raise ValueError("a feature has 3 numbers; a line of features is incomplete")
        yield int(identity), ColmapImage((w, x, y, z), (t_x, t_y, t_z), int(camera_id), name)


def _text_points(path: Path) -> Iterator[tuple[int, ColmapPoint]]:
    for line in filter(None, _lines(path)):
        identity, x, y, z, red, green, blue, _error, *track = _fields(line, at_least=8)
        if len(track) % 2:
            raise ValueError("a track ends in the middle of an observation")
        color = (int(red), int(green), int(blue))
        if not all(0 <= channel <= 255 for channel in color):
            raise ValueError(f"the color {color} is not within 0..255")
        image_ids = [int(image) for image in track[::2]]
        yield int(identity), ColmapPoint((float(x), float(y), float(z)), color, image_ids)


def _lines(path: Path) -> Iterator[str]:
    for line in path.read_bytes().decode().split("\n"):
        if not line.strip().startswith("#"):
            yield line.strip()


def _fields(line: str, at_least: int, at_most: int = 0) -> list[str]:
    """Split a line; the last of `at_most` fields may contain spaces."""
    fields = line.split(maxsplit=at_most - 1)
    if len(fields) < at_least:
        raise ValueError(f"a record has at least {at_least} fields, this one has {len(fields)}")
    return fields


def _unknown_model(model: object) -> str:
    return f"the camera model {model} is not one of {', '.join(_MODELS)}"


class _Cursor:
    def __init__(self, data: bytes) -> None:
        self._data = data
        self._position = 0

    def take(self, layout: str) -> tuple[Any, ...]:
        return struct.unpack(layout, self.skip(struct.calcsize(layout)))

    def skip(self, size: int) -> bytes:
        end = self._position + size
        if end > len(self._data):
            raise ValueError(f"it ends at byte {len(self._data)}, in the middle of a record")
        part = self._data[self._position : end]
        self._position = end
        return part

    def count(self, smallest: int) -> int:
        """Read the number of records that follow, each at least `smallest` bytes long."""
        number: int = self.take("<Q")[0]
        if number * smallest > len(self._data) - self._position:
            raise ValueError(f"it claims {number} records, which it is too short for")
        return number

    def text(self) -> str:
        end = self._data.find(b"\0", self._position)
        if end < 0:
            raise ValueError("it ends in the middle of a name")
        text = self._data[self._position : end].decode()
        self._position = end + 1
        return text

    def end(self) -> None:
        if self._position != len(self._data):
            raise ValueError(f"{len(self._data) - self._position} bytes follow its last record")
