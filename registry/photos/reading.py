"""Reading files that nobody vouches for: what a decoder raises becomes one explained error."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Annotated, Any, TypeVar

import pydantic

from core_rasterizer import ExplainedError

from ..errors import SceneError

Document = TypeVar("Document", bound=pydantic.BaseModel)

Finite = Annotated[float, pydantic.Field(allow_inf_nan=False)]
MatrixRow = tuple[Finite, Finite, Finite, Finite]
Matrix4x4 = tuple[MatrixRow, MatrixRow, MatrixRow, MatrixRow]

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
    try:
        yield
    except ExplainedError:
        raise
    except Exception as error:
        reason = str(error) or type(error).__name__
        raise SceneError(f"{what} cannot be read: {reason}", where=str(path), fix=fix) from error


def read_document(path: Path, model: type[Document], fix: str) -> Document:
    """Read a JSON file and hold it to a model of its fields.

    Raises:
        SceneError: the file is missing, is no JSON, lacks a field, or has a field of a wrong type.
    """
    if not path.is_file():
        raise SceneError(f"the file {path.name} is missing", where=str(path), fix=fix)
    with decoding(path.name, path, fix):
        content: Any = json.loads(path.read_bytes())
        # Through JSON again: only so do pydantic's strict types take a list as a tuple.
        text = json.dumps(content)
    try:
        return model.model_validate_json(text, strict=True)
    except pydantic.ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        raise SceneError(
            f"the field {place!r} cannot be used: {first['msg']}",
            where=str(path),
            fix=fix,
        ) from error


def inside(folder: Path, name: str, where: str) -> Path:
    """The path of a file that a camera file names, which must lie inside the scene's folder.

    Raises:
        SceneError: the name is empty, absolute, climbs out with `..`, or is one that no file has.
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
    return folder / relative


def view_names(names: list[str]) -> list[str]:
    """A plain name for each file: its stem, or all of its path where stems repeat."""
    stems = [PurePosixPath(name).stem for name in names]
    if len(set(stems)) == len(stems):
        return stems
    folders = [PurePosixPath(name).parent.parts for name in names]
    return ["_".join([*parts, stem]) for parts, stem in zip(folders, stems, strict=True)]
