"""Read the header of a PLY file, and check the file's size against it.

Without the check, a header of a few bytes could make a reader allocate terabytes.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from ..errors import PlyError

_MAX_HEADER = 1 << 16
_MAX_DIGITS = 18
_OTHER_FORMATS = {
    ".splat": "a scene of the web viewer antimatter15/splat",
    ".ksplat": "a scene of the web viewer GaussianSplats3D",
    ".spz": "a scene compressed by Niantic's SPZ",
    ".sog": "a scene compressed by PlayCanvas",
    ".glb": "a glTF scene",
}
CONVERT = (
    "save it as an uncompressed PLY, for example with SuperSplat or `splat-transform IN OUT.ply`"
)
"""Advice for scenes in another format."""
_SIZES = {
    **dict.fromkeys(("char", "uchar", "int8", "uint8"), 1),
    **dict.fromkeys(("short", "ushort", "int16", "uint16"), 2),
    **dict.fromkeys(("int", "uint", "float", "int32", "uint32", "float32"), 4),
    **dict.fromkeys(("double", "float64"), 8),
}
"""Bytes of a binary value by type name."""


@dataclass(frozen=True)
class ElementHeader:
    """A table of rows that a header declares.

    Args:
        lines: its lines in the header, including comments.
        types: PLY type names of its properties; "list" for one of variable length.
    """

    name: str
    count: int
    types: tuple[str, ...]
    lines: bytes

    @property
    def has_lists(self) -> bool:
        """Whether its rows have variable length."""
        return "list" in self.types

    @property
    def row_bytes(self) -> int:
        """Bytes of a binary row; a lower bound if the length varies."""
        return max(1, sum(_SIZES.get(kind, 1) for kind in self.types))


@dataclass(frozen=True)
class PlyHeader:
    """A parsed header.

    Args:
        preamble: the lines before the first element, including the format.
        text: If True, values are text, one row per line.
        body: offset of the values in bytes.
    """

    preamble: bytes
    elements: tuple[ElementHeader, ...]
    text: bool
    body: int

    def without_rows(self) -> bytes:
        """The header with all row counts set to 0, without comments, which need not be ASCII."""
        lines = b"".join([self.preamble, *(element.lines for element in self.elements)])
        emptied = re.sub(rb"^(element\s+\S+\s+)\d+", rb"\g<1>0", lines, flags=re.MULTILINE)
        plain = re.sub(rb"^(?:comment|obj_info)\b.*\n", b"", emptied, flags=re.MULTILINE)
        return b"".join([b"ply\n", plain, b"end_header\n"])

    @property
    def comments(self) -> list[str]:
        """The texts of its comments."""
        lines = b"".join([self.preamble, *(element.lines for element in self.elements)])
        found = re.findall(rb"^comment\b(.*)$", lines, flags=re.MULTILINE)
        return [comment.decode("utf-8", "replace").strip() for comment in found]


def read_header(path: Path) -> PlyHeader:
    """Read a header and check that the file's size matches it.

    Raises:
        PlyError: the file is missing or not a PLY, an element has no count, or the file is truncated or
            continues after its last row.
    """
    if not path.is_file():
        raise PlyError(
            "the PLY file cannot be opened: file not found",
            where=str(path),
            fix="check the path",
        )
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            start = file.read(_MAX_HEADER)
    except OSError as error:
        raise PlyError(
            f"the PLY file cannot be opened: {error.strerror}",
            where=str(path),
            fix="check the path",
        ) from error
    header = _parse(start, path)
    _check_size(header, size, path)
    return header


def _parse(start: bytes, path: Path) -> PlyHeader:
    found = re.match(rb"ply\s*?\r?\n(.*?)^end_header\s*?\n", start, re.DOTALL | re.MULTILINE)
    if other := _OTHER_FORMATS.get(path.suffix.lower()) if found is None else None:
        raise PlyError(f"this is {other}, not a PLY file", where=str(path), fix=CONVERT)
    if start.startswith((b"\x1f\x8b", b"PK")):
        fix = f"unpack it; or, if it is a compressed scene, {CONVERT}"
        raise PlyError(
            "this is an archive of gzip or zip, not a PLY file", where=str(path), fix=fix
        )
    if found is None:
        raise PlyError(
            "the file does not begin with a complete PLY header",
            where=str(path),
            fix="use a PLY file; it may be truncated",
        )
    preamble, *elements = re.split(rb"^(?=element\s)", found[1], flags=re.MULTILINE)
    return PlyHeader(
        preamble,
        tuple(_element(lines, path) for lines in elements),
        text=re.search(rb"^format\s+ascii\s", preamble, re.MULTILINE) is not None,
        body=found.end(),
    )


def _element(lines: bytes, path: Path) -> ElementHeader:
    words = lines.split(None, 3)
    if len(words) < 3 or not words[2].isdigit() or len(words[2]) > _MAX_DIGITS:
        shown = lines.split(b"\n")[0].decode("ascii", "replace").strip()[:100]
        raise PlyError(
            f"the PLY header has an element without a count: {shown.removeprefix('element ')}",
            where=str(path),
        )
    kinds = re.findall(rb"^property\s+(\S+)", lines, re.MULTILINE)
    return ElementHeader(
        words[1].decode("ascii", "replace"),
        int(words[2]),
        tuple(kind.decode("ascii", "replace") for kind in kinds),
        lines,
    )


def _check_size(header: PlyHeader, size: int, path: Path) -> None:
    # As text, a value takes at least one byte and a separator.
    declared = sum(
        e.count * (max(1, 2 * len(e.types) - 1) if header.text else e.row_bytes)
        for e in header.elements
    )
    held = size - header.body
    if declared > held:
        raise PlyError(
            f"the PLY header declares at least {declared} bytes, but the file has {held}",
            where=str(path),
            fix="it is truncated or damaged; copy or export it again",
        )
    if header.text:
        rows, total = _rows(path, header.body), sum(e.count for e in header.elements)
        problem = f"{total} rows, but the file has {rows}" if rows != total else ""
    else:
        exact = not any(element.has_lists for element in header.elements)
        problem = f"{declared} bytes, but the file has {held}" if exact and declared < held else ""
    if problem:
        raise PlyError(
            f"the PLY header declares {problem}",
            where=str(path),
            fix="it is damaged; copy or export it again",
        )


def _rows(path: Path, body: int) -> int:
    """Number of lines with values in a text file."""
    with path.open("rb") as file:
        file.seek(body)
        return sum(1 for line in file if not line.isspace())
