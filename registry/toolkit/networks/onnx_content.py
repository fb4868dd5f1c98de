"""What an ONNX file says before it is opened: whether onnxruntime may be given it.

A tensor may keep its numbers in a second file, of any path; onnxruntime looks for it from the folder
that the process happens to be in, and no hash of the model covers it. And a loop or a branch that is
decided by an empty tensor ends the whole process: onnxruntime reads the first of no elements. Only the
way to tensors and nodes is followed here (onnx.proto, IR version 10).
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from ...errors import PluginError
from .protocol_buffer import fields, whole_numbers

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


_TENSOR_DIMENSIONS, _TENSOR_NAME = 1, 8
_NODE_INPUT, _NODE_OPERATOR = 1, 4
_DECIDED_BY = {b"Loop": 2, b"If": 1}
"""By operator, how many of its first inputs decide what it does; each holds one element."""


def check_content(content: bytes, path: Path) -> None:
    """Refuse a model whose weights lie in a second file, one that would end the process, and damage.

    Raises:
        PluginError: it is one of these.
    """
    try:
        messages = list(_messages(memoryview(content)))
        apart = any(kind == _TENSOR and _lies_elsewhere(part) for kind, part in messages)
        undecided = _undecided(messages)
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
    if undecided:
        raise PluginError(
            f"a loop or a branch of the model is decided by {undecided!r}, which has no elements",
            where=str(path),
            fix="export the model to ONNX again; such a tensor must hold one number",
        )


def _messages(content: memoryview) -> Iterator[tuple[str, memoryview]]:
    """The model, and all that leads to its tensors, each with its kind."""
    waiting = [("model", content)]
    while waiting:
        kind, part = waiting.pop()
        yield kind, part
        for field, value in fields(part):
            if isinstance(value, memoryview) and field in _PATHS.get(kind, {}):
                waiting.append((_PATHS[kind][field], value))


def _lies_elsewhere(tensor: memoryview) -> bool:
    return any(
        field == _EXTERNAL_DATA or (field == _DATA_LOCATION and value)
        for field, value in fields(tensor)
    )


def _undecided(messages: list[tuple[str, memoryview]]) -> str | None:
    """The name of an empty tensor that decides a loop or a branch."""
    empty = {_empty_name(part) for kind, part in messages if kind == _TENSOR} - {None}
    for kind, part in messages:
        if kind == "node" and empty:
            parts = list(fields(part))
            operators = [bytes(value) for field, value in parts if field == _NODE_OPERATOR]
            inputs = [bytes(value) for field, value in parts if field == _NODE_INPUT]
            deciding = inputs[: max((_DECIDED_BY.get(name, 0) for name in operators), default=0)]
            for name in deciding:
                if name and name in empty:
                    return name.decode("utf-8", "replace")
    return None


def _empty_name(tensor: memoryview) -> bytes | None:
    """Its name where it has no elements."""
    name, sizes = b"", []
    for field, value in fields(tensor):
        if field == _TENSOR_NAME and isinstance(value, memoryview):
            name = bytes(value)
        elif field == _TENSOR_DIMENSIONS:
            sizes += whole_numbers(value)
    return name if 0 in sizes else None
