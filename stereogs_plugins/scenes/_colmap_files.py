"""Two files of a COLMAP model, read with care: image names and point tracks.

COLMAP's own reader trusts the counts in a file; on a truncated one it allocates until memory ends.
Here nothing is believed that the file is too short for. Layout: little-endian,

    images.bin    u64 n, n x (i32 id, 7 f64 pose, i32 camera, name, 0, u64 m, m x (2 f64, i64))
    points3D.bin  u64 n, n x (u64 id, 3 f64 position, 3 u8 colour, f64 error, u64 m, m x (2 i32))
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np


class ColmapPoint(NamedTuple):
    """A point: position `(x, y, z)`, colour 0..255, and the ids of the images that see it."""

    position: tuple[float, float, float]
    color: tuple[int, int, int]
    image_ids: list[int]


def read_image_names(path: Path) -> dict[int, str]:
    """Image id to image name, from images.bin.

    Raises:
        ValueError: the file does not have the layout above.
    """
    cursor = _Cursor(path.read_bytes())
    names = {}
    for _ in range(cursor.count(smallest=73)):
        identity = cursor.take("<i7di")[0]
        names[identity] = cursor.text()
        cursor.skip(cursor.count(smallest=24) * 24)
    cursor.end()
    return names


def read_points3d(path: Path) -> list[ColmapPoint]:
    """All points in the order of their ids, from points3D.bin.

    Raises:
        ValueError: the file does not have the layout above.
    """
    cursor = _Cursor(path.read_bytes())
    points = {}
    for _ in range(cursor.count(smallest=51)):
        identity, x, y, z, red, green, blue, _error = cursor.take("<Q3d3Bd")
        track = np.frombuffer(cursor.skip(cursor.count(smallest=8) * 8), dtype="<i4")
        points[identity] = ColmapPoint((x, y, z), (red, green, blue), track[::2].tolist())
    cursor.end()
    return [points[identity] for identity in sorted(points)]


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
        """A number of records that follow, each at least `smallest` bytes long."""
        number: int = self.take("<Q")[0]
        if number * smallest > len(self._data) - self._position:
            raise ValueError(f"it announces {number} records, which it is too short for")
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
