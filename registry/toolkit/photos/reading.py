"""Reading files that nobody vouches for: what a decoder raises becomes one explained error."""

from __future__ import annotations

from contextlib import contextmanager
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import TYPE_CHECKING, Annotated, TypeVar

import pydantic

from ...errors import SceneError
from .images.image_files import existing_image

if TYPE_CHECKING:
    from collections.abc import Iterator

Document = TypeVar("Document", bound=pydantic.BaseModel)

Finite = Annotated[float, pydantic.Field(allow_inf_nan=False)]
MatrixRow = tuple[Finite, Finite, Finite, Finite]
Matrix4x4 = tuple[MatrixRow, MatrixRow, MatrixRow, MatrixRow]

_LARGEST_DOCUMENT = 12_000_000
"""Bytes; cameras of 10,000 photographs take 10 MB."""
_LONGEST_NAME = 240
"""Bytes; file systems stop at 255."""


@contextmanager
def decoding(what: str, path: Path, fix: str) -> Iterator[None]:
    """Explain a file that a decoder gives up on.

    numpy, zipfile, zlib, Pillow and plyfile between them raise a dozen kinds of errors on damaged
    input, MemoryError for an announced size among them; no list of them would stay complete.

    Raises:
        SceneError: for whatever the block raises, other than an explained error.
    """
    from core_rasterizer import ExplainedError

    try:
        yield
    except ExplainedError:
        raise
    except Exception as error:
        reason = str(error) or type(error).__name__
        raise SceneError(f"{what} cannot be read: {reason}", where=str(path), fix=fix) from error


def require_file(path: Path, what: str, fix: str) -> None:
    """Refuse what is not there, and what has no end or never answers: folders, devices, pipes.

    Raises:
        SceneError: there is no regular file of this name.
    """
    if not path.is_file():
        state = "is no regular file" if path.exists() else "is missing"
        raise SceneError(f"{what} {state}", where=str(path), fix=fix)


def read_document(path: Path, model: type[Document], fix: str) -> Document:
    """Read a JSON file and hold it to a model of its fields.

    Raises:
        SceneError: the file is missing, larger than 12 MB, is no JSON, lacks a field, or has a field
            of a wrong type.
    """
    require_file(path, f"the file {path.name}", fix)
    size = path.stat().st_size
    if size > _LARGEST_DOCUMENT:
        raise SceneError(
            f"the file {path.name} has {size:,} bytes, more than {_LARGEST_DOCUMENT:,}",
            where=str(path),
            fix=fix,
        )
    with decoding(path.name, path, fix):
        content = path.read_bytes()
    try:
        return model.model_validate_json(content, strict=True)
    except pydantic.ValidationError as error:
        first = error.errors()[0]
        if first["type"] == "json_invalid":
            raise SceneError(
                f"{path.name} cannot be read: {first['msg']}", where=str(path), fix=fix
            ) from error
        place = ".".join(str(part) for part in first["loc"])
        raise SceneError(
            f"the field {place!r} cannot be used: {first['msg']}",
            where=str(path),
            fix=fix,
        ) from error


def inside(folder: Path, name: str, where: str) -> Path:
    """The path of a file that a camera file names, which must lie inside the scene's folder.

    Raises:
        SceneError: the name is empty, absolute, climbs out with `..`, is one that no file has, or leads
            out through a symbolic link.
    """
    relative = PurePosixPath(name)
    if (
        not relative.parts
        or relative.is_absolute()
        or PureWindowsPath(name).drive
        or ".." in relative.parts
        or "\\" in name
        or not name.isprintable()
        or max(len(part.encode()) for part in relative.parts) > _LONGEST_NAME
    ):
        raise SceneError(
            f"the file name {name[:100]!r} does not stay inside the scene's folder",
            where=where,
            fix="use relative names below the folder, with / between folders",
        )
    path = folder / relative
    # An image may be found under another ending than the file says.
    real = (existing_image(path) or path).resolve()
    if not real.is_relative_to(folder.resolve()):
        raise SceneError(
            f"the file {name[:100]!r} is a link to {real}, outside the scene's folder",
            where=where,
            fix="copy what it links to into the scene's folder (cp -rL copies what links lead to)",
        )
    return path


def view_names(names: list[str]) -> list[str]:
    """A plain name for each file: its stem, or all of its path where stems repeat."""
    stems = [PurePosixPath(name).stem for name in names]
    if len(set(stems)) == len(stems):
        return stems
    folders = [PurePosixPath(name).parent.parts for name in names]
    return ["_".join([*parts, stem]) for parts, stem in zip(folders, stems, strict=True)]
