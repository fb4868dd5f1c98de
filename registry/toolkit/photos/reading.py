"""Read untrusted files: JSON documents and NumPy arrays; find the files that they name."""

from __future__ import annotations

import io
import json
import math
import zipfile
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import TYPE_CHECKING, Annotated, Any, TypeVar
from unicodedata import normalize
from urllib.parse import unquote

import pydantic

from ...errors import SceneError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    Array = NDArray[Any]

Document = TypeVar("Document", bound=pydantic.BaseModel)

Finite = Annotated[float, pydantic.Field(allow_inf_nan=False)]
MatrixRow = tuple[Finite, Finite, Finite, Finite]
PoseMatrix = Annotated[tuple[MatrixRow, ...], pydantic.Field(min_length=3, max_length=4)]
"""A pose `[4, 4]`, or `[3, 4]` without the last row."""

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".bmp", ".heic", ".heif")
"""Suffixes of files that are read as photographs, in lower case."""
MAX_GROWTH = 10
"""Unpacked size of an archive divided by its file size, at most; real arrays shrink to a half at best."""
UNCHECKED_BYTES = 1 << 26
"""64 MiB; archives that unpack to less may have any compression ratio."""
_MAX_DOCUMENT = 12_000_000
"""Bytes; cameras of 10,000 photographs take 10 MB."""
_MAX_NAME = 240
"""Bytes; file systems allow 255."""


@contextmanager
def decoding(what: str, path: Path, fix: str) -> Iterator[None]:
    """Convert any exception of the block to a `SceneError`, except errors that are already explained.

    On damaged input numpy, zipfile, zlib, Pillow and plyfile raise a dozen kinds of exceptions, among
    them MemoryError for a size that a header claims; a list of them would never be complete.

    Raises:
        SceneError: The block raised.
    """
    from core_rasterizer import ExplainedError

    try:
        yield
    except ExplainedError:
        raise
    except Exception as error:
        reason = str(error) or type(error).__name__
        raise SceneError(f"{what} cannot be read: {reason}", where=str(path), fix=fix) from error


def _require_file(path: Path, what: str, fix: str) -> None:
    """Refuse missing files, folders, devices and pipes; reading a device may never end."""
    if not path.is_file():
        state = "is not a regular file" if path.exists() else "is missing"
        raise SceneError(f"{what} {state}", where=str(path), fix=fix)


def read_document(path: Path, model: type[Document], fix: str) -> Document:
    """Read a JSON file and validate it against a pydantic model, with strict types.

    Raises:
        SceneError: The file is missing, larger than 12 MB, not JSON, lacks a field, has a field of a
            wrong type, or names one twice.
    """
    _require_file(path, f"the file {path.name}", fix)
    size = path.stat().st_size
    if size > _MAX_DOCUMENT:
        raise SceneError(
            f"the file {path.name} has {size:,} bytes, more than {_MAX_DOCUMENT:,}",
            where=str(path),
            fix=fix,
        )
    with decoding(path.name, path, fix):
        content = decoded(path.read_bytes())
    try:
        read = model.model_validate_json(content, strict=True)
        json.loads(content, object_pairs_hook=_refuse_repeated)
        return read
    except _RepeatedName as error:
        raise SceneError(
            f"{path.name} has the field {error} twice", where=str(path), fix=fix
        ) from error
    except pydantic.ValidationError as error:
        first = error.errors()[0]
        what = f"the field {'.'.join(map(str, first['loc']))!r} cannot be used"
        if first["type"] == "json_invalid" or not first["loc"]:
            what = f"{path.name} cannot be read"
        raise SceneError(f"{what}: {first['msg']}", where=str(path), fix=fix) from error


def decoded(content: bytes) -> str:
    """Return the text of a file in UTF-8, or in the UTF-16 of Windows PowerShell, without the mark."""
    marked = content.startswith((BOM_UTF16_LE, BOM_UTF16_BE))
    return content.decode("utf-16" if marked else "utf-8-sig")


class _RepeatedName(Exception):
    """A name occurs twice in an object."""


def _refuse_repeated(pairs: list[tuple[str, object]]) -> None:
    names = set[str]()
    for name, _ in pairs:
        if name in names:
            raise _RepeatedName(repr(name))
        names.add(name)


def read_array(path: Path, what: str, fix: str) -> Array:
    """Read the array of an `.npy` file.

    Unlike `numpy.load`, this unpickles no objects and allocates nothing before it has compared the
    shape in the header with the file's size.

    Args:
        what: Name of the file's content for error messages, such as "the poses".

    Raises:
        SceneError: The file is missing or not in this format, its header claims another size than the
            file has, or it holds Python objects.
    """
    _require_file(path, what, fix)
    with decoding(what, path, fix):
        return _parsed(path.read_bytes())


def read_arrays(path: Path, names: Sequence[str], what: str, fix: str) -> dict[str, Array]:
    """Read arrays of an `.npz` file by name, with the checks of `read_array`; ignore all others.

    Raises:
        SceneError: See `read_array`; also if an array is missing, or the arrays would unpack to more
            than 64 MiB and more than ten times the file's size.
    """
    _require_file(path, what, fix)
    with decoding(what, path, fix), zipfile.ZipFile(path) as archive:
        members = [archive.getinfo(f"{name}.npy") for name in names]
        unpacked = sum(member.file_size for member in members)
        most = max(UNCHECKED_BYTES, MAX_GROWTH * path.stat().st_size)
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
        raise ValueError("it holds Python objects; reading them would run code")
    claimed, present = math.prod(shape) * dtype.itemsize, len(content) - file.tell()
    if not dtype.itemsize or claimed != present:
        raise ValueError(f"its header claims {claimed} bytes of numbers, but {present} follow")
    values = np.frombuffer(content, dtype, offset=file.tell())
    return values.reshape(shape, order="F" if by_column else "C").copy()


def find_image(path: Path, fix: str = "restore it, or choose other views") -> Path:
    """Return the file, or the image of the same name with another suffix.

    Raises:
        SceneError: Neither exists.
    """
    found = existing_image(path)
    if found is None:
        raise SceneError("a photograph is missing", where=str(path), fix=fix)
    return found


def existing_image(path: Path) -> Path | None:
    """Return the file itself, or one whose name differs in Unicode form, suffix, case or `%20` only."""
    names = [path.name, *(normalize(form, path.name) for form in ("NFC", "NFD"))]
    plain = PurePosixPath(unquote(path.name)).name  # a / that it holds does not lead elsewhere
    spellings = [path.with_name(name) for name in (*names, plain) if name]
    suffixes = [spelling for suffix in IMAGE_SUFFIXES for spelling in (suffix, suffix.upper())]
    others = [named.with_name(named.stem + suffix) for named in spellings for suffix in suffixes]
    found = next((file for file in [*spellings, *others] if file.is_file()), None)
    return found or _in_other_case(path)


def _in_other_case(path: Path) -> Path | None:
    """Return the only image whose name differs in case, and perhaps in suffix; None if there are several.

    Folders may differ in case, too.
    """
    folder = path.parent if path.parent.is_dir() else _folder_in_other_case(path.parent)
    if folder is None:
        return None
    files = _files_by_name(folder, folder.stat().st_mtime_ns)
    plain = Path(normalize("NFC", path.name).lower())
    names = [plain.name, *(plain.stem + suffix for suffix in IMAGE_SUFFIXES)]
    found = next((files[name] for name in names if name in files), ())
    return found[0] if len(found) == 1 else None


def _folder_in_other_case(path: Path) -> Path | None:
    parent = path.parent if path.parent.is_dir() else None
    if parent is None and path.parent != path:
        parent = _folder_in_other_case(path.parent)
    name = normalize("NFC", path.name).lower()
    found = [
        child
        for child in (parent.iterdir() if parent else ())
        if child.is_dir() and normalize("NFC", child.name).lower() == name
    ]
    return found[0] if len(found) == 1 else None


@lru_cache(maxsize=8)
def _files_by_name(folder: Path, changed: int) -> dict[str, list[Path]]:
    """Files of a folder by name in lower case; `changed`, its time of change, makes a new list."""
    files: dict[str, list[Path]] = {}
    for path in sorted(folder.iterdir()):
        if path.is_file():
            files.setdefault(normalize("NFC", path.name).lower(), []).append(path)
    return files


def list_images(folder: Path) -> list[Path]:
    """Return the visible image files of a folder, sorted by name; none if the folder is missing."""
    if not folder.is_dir():
        return []
    visible = (path for path in folder.iterdir() if not path.name.startswith("."))
    return sorted(path for path in visible if path.suffix.lower() in IMAGE_SUFFIXES)


def inside(folder: Path, name: str, where: str) -> Path:
    """Return the path of a file that a camera file names; it must lie inside the scene's folder.

    Backslashes separate folders as slashes do. An absolute path is accepted if it leads into the folder, or,
    on another machine, if the file is there under the longest end of the path that exists.

    Raises:
        SceneError: The name is empty, contains `..` or characters that file names cannot have, or leads
            out of the folder, also through a symbolic link.
    """
    relative = PurePosixPath(name.replace("\\", "/"))
    root = folder.absolute()
    if relative.is_absolute() and relative.is_relative_to(root):
        relative = relative.relative_to(root)
    possible = (
        bool(relative.parts)
        and ".." not in relative.parts
        and name.isprintable()
        and max(len(part.encode()) for part in relative.parts) <= _MAX_NAME
    )
    if possible and (relative.is_absolute() or PureWindowsPath(relative).drive):
        ends = [PurePosixPath(*relative.parts[k:]) for k in range(1, len(relative.parts))]
        relative = next((end for end in ends if existing_image(folder / end)), relative)
    if not possible or relative.is_absolute() or PureWindowsPath(relative).drive:
        raise SceneError(
            f"the file name {name[:100]!r} does not stay inside the scene's folder",
            where=where,
            fix="use relative names below the folder, with / between folders",
        )
    path = folder / relative
    # The image may have another suffix than the camera file says.
    real = (existing_image(path) or path).resolve()
    if not real.is_relative_to(folder.resolve()):
        raise SceneError(
            f"the file {name[:100]!r} is a link to {real}, outside the scene's folder",
            where=where,
            fix="copy the linked file into the scene's folder (cp -rL follows links)",
        )
    return path


def view_names(names: list[str]) -> list[str]:
    """Return a view name for each file: its stem, or its whole path where stems repeat."""
    stems = [PurePosixPath(name).stem for name in names]
    if len(set(stems)) == len(stems):
        return stems
    folders = [PurePosixPath(name).parent.parts for name in names]
    return ["_".join([*parts, stem]) for parts, stem in zip(folders, stems, strict=True)]
