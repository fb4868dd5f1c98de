"""The header of a PLY file, and whether what follows can be what it promises.

A reader makes room for the promised rows before it looks for them: a few bytes could ask for terabytes.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from .errors import PlyError

_LONGEST_HEADER = 1 << 16
_MOST_DIGITS = 18
_SIZES = {
    **dict.fromkeys(("char", "uchar", "int8", "uint8"), 1),
    **dict.fromkeys(("short", "ushort", "int16", "uint16"), 2),
    **dict.fromkeys(("int", "uint", "float", "int32", "uint32", "float32"), 4),
    **dict.fromkeys(("double", "float64"), 8),
}
"""Bytes of a binary value by the name of its type."""


@dataclass(frozen=True)
class ElementHeader:
    """A table of rows that a header announces.

    Args:
        lines: of the header that announce it, comments between them included.
        types: of its properties, by PLY's names; "list" for one of varying length.
    """

    name: str
    count: int
    types: tuple[str, ...]
    lines: bytes

    @property
    def has_lists(self) -> bool:
        """Whether the length of its rows varies."""
        return "list" in self.types

    @property
    def row_bytes(self) -> int:
        """Of a binary row; the least it can have where that is not known."""
        return max(1, sum(_SIZES.get(kind, 1) for kind in self.types))


@dataclass(frozen=True)
class PlyHeader:
    """What a file says of itself.

    Args:
        preamble: the lines before the first element, the format among them.
        text: values are written as text, a row in a line.
        body: where the values begin, bytes.
    """

    preamble: bytes
    elements: tuple[ElementHeader, ...]
    text: bool
    body: int

    def without_rows(self) -> bytes:
        """The header of the same elements with no row in any."""
        lines = b"".join(element.lines for element in self.elements)
        emptied = re.sub(rb"^(element\s+\S+\s+)\d+", rb"\g<1>0", lines, flags=re.MULTILINE)
        return b"".join([b"ply\n", self.preamble, emptied, b"end_header\n"])


def read_header(path: Path) -> PlyHeader:
    """The header of a file that is long enough for what it promises, and no longer where that shows.

    Raises:
        PlyError: there is no such file; it is no PLY, an element has no count, or the file is cut off
            or has something behind its last row.
    """
    if not path.is_file():
        raise PlyError(
            "the PLY file cannot be opened: there is no such file",
            where=str(path),
            fix="check the path",
        )
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            start = file.read(_LONGEST_HEADER)
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
    if found is None:
        raise PlyError(
            "the file does not begin with a complete PLY header",
            where=str(path),
            fix="give a PLY file; if it is one, it may be cut off",
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
    if len(words) < 3 or not words[2].isdigit() or len(words[2]) > _MOST_DIGITS:
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
    # Every value takes at least one byte as text, and a space or line break behind it.
    promised = sum(
        e.count * (max(1, 2 * len(e.types) - 1) if header.text else e.row_bytes)
        for e in header.elements
    )
    held = size - header.body
    if promised > held:
        raise PlyError(
            f"the PLY header promises at least {promised} bytes, but the file has {held}",
            where=str(path),
            fix="it is cut off or damaged; copy or export it again",
        )
    if header.text:
        rows, announced = _rows(path, header.body), sum(e.count for e in header.elements)
        problem = f"{announced} rows, but the file has {rows}" if rows != announced else ""
    else:
        exact = not any(element.has_lists for element in header.elements)
        problem = f"{promised} bytes, but the file has {held}" if exact and promised < held else ""
    if problem:
        raise PlyError(
            f"the PLY header promises {problem}",
            where=str(path),
            fix="it is damaged; copy or export it again",
        )


def _rows(path: Path, body: int) -> int:
    """How many lines with values a text file has."""
    with path.open("rb") as file:
        file.seek(body)
        return sum(1 for line in file if not line.isspace())
