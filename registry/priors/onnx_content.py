"""What an ONNX file says before it is opened: whether all of it lies in the one file.

A tensor may keep its numbers in a second file, of any path; onnxruntime looks for it from the folder
that the process happens to be in, and no hash of the model covers it. ONNX is a protocol buffer: fields
of a number and a length. Only the way to its tensors is followed here (onnx.proto, IR version 10).
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from ..errors import PluginError

_TENSOR = "tensor"
_PATHS: dict[str, dict[int, str]] = {
    "model": {7: "graph", 20: "training", 25: "function"},
    "training": {1: "graph", 2: "graph"},
    "graph": {1: "node", 5: _TENSOR, 15: "sparse"},
    "function": {7: "node", 11: "attribute"},
    "node": {5: "attribute"},
    "attribute": {
        **{5: _TENSOR, 6: "graph", 22: "sparse"},
        **{10: _TENSOR, 11: "graph", 23: "sparse"},
    },
    "sparse": {1: _TENSOR, 2: _TENSOR},
}
"""By message, the fields that lead to tensors, and what message each holds."""
_EXTERNAL_DATA, _DATA_LOCATION = 13, 14
"""Fields of a tensor that say that its numbers lie elsewhere."""
_FIXED_SIZES = {1: 8, 5: 4}
_LENGTH, _NUMBER = 2, 0


def check_in_one_file(content: bytes, path: Path) -> None:
    """Refuse a model whose weights lie in a second file, and what is no protocol buffer.

    Raises:
        PluginError: they do, or it is none.
    """
    try:
        apart = _has_weights_apart(memoryview(content))
    except (ValueError, IndexError) as error:
        raise PluginError(
            "the file is no ONNX model that onnxruntime can load: it is cut off or damaged",
            where=str(path),
            fix="export the model to ONNX again, or copy it again",
        ) from error
    if apart:
        raise PluginError(
            "the model keeps its weights in a second file, which no hash would cover",
            where=str(path),
            fix="write it as one file: onnx.save(onnx.load(path), new_path)",
        )


def _has_weights_apart(content: memoryview) -> bool:
    waiting = [("model", content)]
    while waiting:
        message, part = waiting.pop()
        for field, value in _fields(part):
            if message == _TENSOR:
                if field == _EXTERNAL_DATA or (field == _DATA_LOCATION and value):
                    return True
            elif field in _PATHS[message] and isinstance(value, memoryview):
                waiting.append((_PATHS[message][field], value))
    return False


def _fields(part: memoryview) -> Iterator[tuple[int, int | memoryview]]:
    """The numbers and the parts of a message, by field."""
    place = 0
    while place < len(part):
        tag, place = _number(part, place)
        field, kind = tag >> 3, tag & 7
        if kind == _NUMBER:
            value, place = _number(part, place)
            yield field, value
            continue
        size, place = _number(part, place) if kind == _LENGTH else (_FIXED_SIZES.get(kind), place)
        if size is None or place + size > len(part):
            raise ValueError(f"field {field} of kind {kind} does not fit")
        yield field, part[place : place + size]
        place += size


def _number(part: memoryview, place: int) -> tuple[int, int]:
    """A number of seven bits a byte, the lowest first, and where it ends."""
    value = shift = 0
    while shift < 70:
        byte = part[place]
        place += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, place
        shift += 7
    raise ValueError("a number of more than ten bytes")
