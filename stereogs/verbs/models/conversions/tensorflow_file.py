"""Read frozen TensorFlow graphs (`GraphDef`) without TensorFlow."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from registry.toolkit.networks.model_file import Schema, message_type

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

FLOAT, INT32, INT64 = 1, 3, 9
_TYPES = {FLOAT: np.float32, INT32: np.int32, INT64: np.int64}
_TEXT, _BYTES, _NUMBER, _REAL = "TYPE_STRING", "TYPE_BYTES", "TYPE_INT64", "TYPE_FLOAT"
_SCHEMA: Schema = {
    "Graph": {"node": (1, "Node")},
    "Node": {"name": (1, _TEXT), "op": (2, _TEXT), "input": (3, _TEXT), "attr": (5, "Entry")},
    "Entry": {"key": (1, _TEXT), "value": (2, "Value")},
    "Value": {
        **{"list": (1, "List"), "text": (2, _BYTES), "number": (3, _NUMBER), "real": (4, _REAL)},
        **{"flag": (5, _NUMBER), "type": (6, _NUMBER), "tensor": (8, "Tensor")},
    },
    "List": {"number": (3, _NUMBER)},
    "Shape": {"dim": (2, "Dimension")},
    "Dimension": {"size": (1, _NUMBER)},
    "Tensor": {
        **{"type": (1, _NUMBER), "shape": (2, "Shape"), "content": (4, _BYTES)},
        **{"reals": (5, _REAL), "numbers": (7, _NUMBER), "long_numbers": (10, _NUMBER)},
    },
}
"""Part of tensorflow's graph.proto and its imports: the fields that are read, by number and type."""


class Node:
    """A node of a graph.

    Attributes:
        name, operator: as in the file.
        inputs: outputs of other nodes, `name` or `name:number`.
    """

    def __init__(self, message: Any) -> None:
        self.name, self.operator = message.name[-1], message.op[-1]
        self.inputs: list[str] = list(message.input)
        self._values = {entry.key[-1]: entry.value[-1] for entry in message.attr}

    def number(self, name: str) -> int:
        """An attribute that is a number, a flag or a type; 0 if it is not given."""
        value = self._values.get(name)
        given = (value.number, value.flag, value.type) if value is not None else ()
        return next((int(numbers[-1]) for numbers in given if numbers), 0)

    def numbers(self, name: str) -> list[int]:
        """An attribute that is a list of numbers."""
        return [int(number) for number in self._values[name].list[-1].number]

    def real(self, name: str) -> float:
        """An attribute that is a real number."""
        return float(self._values[name].real[-1])

    def text(self, name: str) -> str:
        """An attribute that is a text."""
        return str(self._values[name].text[-1].decode())

    def tensor(self) -> NDArray[Any]:
        """The value of a constant."""
        tensor = self._values["value"].tensor[-1]
        dtype = _TYPES[tensor.type[-1]]
        shape = [
            dim.size[-1] if dim.size else 0 for shape in tensor.shape[-1:] for dim in shape.dim
        ]
        if tensor.content:
            return np.frombuffer(tensor.content[-1], dtype).reshape(shape)
        written = [*tensor.reals, *tensor.numbers, *tensor.long_numbers]
        values = np.array(written or [0], dtype)
        # The last value stands for all that follow.
        missing = int(np.prod(shape, dtype=int)) - len(values)
        return np.concatenate([values, np.repeat(values[-1:], max(missing, 0))]).reshape(shape)


def nodes(content: bytes) -> Iterator[Node]:
    """Yield the nodes of a file in its order, inputs first."""
    for message in _graph_type().FromString(content).node:
        yield Node(message)


@cache
def _graph_type() -> Any:
    return message_type(_SCHEMA, "Graph")
