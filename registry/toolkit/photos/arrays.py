"""numpy's files, held to their own size: no object is unpickled and no announced shape is believed.

An `.npz` is a zip archive, whose members may unpack to a thousand times the file; numpy itself makes
room for whatever a header announces before it looks at what follows.
"""

from __future__ import annotations

import io
import zipfile
from typing import TYPE_CHECKING, Any

from .reading import decoding, require_file

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    Array = NDArray[Any]

LARGEST_GROWTH = 10
"""What a whole archive may unpack to, in sizes of its file; real arrays are packed to a half at best."""
UNQUESTIONED_BYTES = 1 << 26
"""64 MiB; an archive may unpack to as much, however small its file is."""


def read_array(path: Path, what: str, fix: str) -> Array:
    """The array of an `.npy` file.

    Args:
        what: it is, for error messages.

    Raises:
        SceneError: the file is missing, no such file, of another size than it announces, or holds
            Python objects.
    """
    require_file(path, what, fix)
    with decoding(what, path, fix):
        return _parsed(path.read_bytes())


def read_arrays(path: Path, names: Sequence[str], what: str, fix: str) -> dict[str, Array]:
    """Arrays of an `.npz` file by name; others in it are not looked at.

    Raises:
        SceneError: see `read_array`; or an array is missing, or together they would unpack to more
            than 64 MiB and ten times the file.
    """
    require_file(path, what, fix)
    with decoding(what, path, fix), zipfile.ZipFile(path) as archive:
        members = [archive.getinfo(f"{name}.npy") for name in names]
        unpacked = sum(member.file_size for member in members)
        most = max(UNQUESTIONED_BYTES, LARGEST_GROWTH * path.stat().st_size)
        if unpacked > most:
            raise ValueError(f"it would unpack to {unpacked:,} bytes, more than {most:,}")
        return {
            name: _parsed(archive.read(member)) for name, member in zip(names, members, strict=True)
        }


def _parsed(content: bytes) -> Array:
    import numpy as np
    from numpy.lib import format as npy

    file = io.BytesIO(content)
    version = npy.read_magic(file)
    header = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    shape, by_column, dtype = header(file)
    if dtype.hasobject:
        raise ValueError("it holds Python objects, which would have to run code to be read")
    count = 1
    for size in shape:
        count *= size
    announced, held = count * dtype.itemsize, len(content) - file.tell()
    if not dtype.itemsize or announced != held:
        raise ValueError(f"it announces {announced} bytes of numbers and holds {held}")
    values = np.frombuffer(content, dtype, offset=file.tell())
    return values.reshape(shape, order="F" if by_column else "C").copy()
