"""The arguments of kernels, read from their source.

OpenCL can report them too (`clGetKernelArgInfo`), but not every driver does.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from operator import attrgetter, index
from typing import Any

import numpy as np

from ..errors import ExplainedError

_COMMENT = re.compile(r"/\*.*?\*/|//[^\n]*", re.DOTALL)
_KERNEL = re.compile(r"__kernel\b[^;{]*?\bvoid\s+(\w+)\s*\(([^)]*)\)")
_ARGUMENT = re.compile(r"(.*\W)(\w+)", re.DOTALL)
_buffer = attrgetter("buffer")


class Signature:
    """The arguments of one kernel, in order.

    Args:
        kernel: its name, for errors.
        arguments: type by name; "buffer" is an array, other types are OpenCL's scalars.
        real: numpy's type of the kernels' `real`.
    """

    def __init__(self, kernel: str, arguments: Mapping[str, str], real: type[np.floating]) -> None:
        self._kernel = kernel
        self.names, self._count = tuple(arguments), len(arguments)
        known: dict[str, tuple[Any, Callable[[Any], Any]]] = {
            "buffer": (None, _buffer),
            "int": (np.int32, index),
            "uint": (np.uint32, index),
            "real": (real, real),
        }
        self.types = [known[kind][0] for kind in arguments.values()]
        """Numpy's types of the scalars, None for arrays."""
        self._converted = [(name, known[kind][1]) for name, kind in arguments.items()]

    def values(self, arguments: Mapping[str, Any]) -> list[Any]:
        """The values of named arguments in the kernel's order: buffers and numbers.

        Raises:
            ExplainedError: a name is missing or unknown, or an array is given for a number or vice versa.
        """
        try:
            if len(arguments) != self._count:
                raise self._wrong(arguments)
            return [convert(arguments[name]) for name, convert in self._converted]
        except (KeyError, AttributeError, TypeError) as error:
            raise self._wrong(arguments) from error

    def _wrong(self, arguments: Mapping[str, Any]) -> ExplainedError:
        missing = [name for name in self.names if name not in arguments]
        unknown = [name for name in arguments if name not in self.names]
        parts = [f"without {', '.join(missing)}"] if missing else []
        parts += [f"with the unknown {', '.join(unknown)}"] if unknown else []
        if not parts:
            kinds = {name: type(arguments[name]).__name__ for name in self.names}
            parts = [f"with arguments of wrong types: {kinds}"]
        return ExplainedError(
            f"the kernel {self._kernel} was launched {' and '.join(parts)}",
            where=f"launch of the kernel {self._kernel}",
            fix=f"it takes {', '.join(self.names)}",
        )


def signatures(source: str, real: type[np.floating]) -> dict[str, Signature]:
    """The signatures of all kernels in a source.

    Args:
        source: OpenCL C. Conditional compilation within a list of arguments is not supported; macros without
            arguments are.
    """
    text = _COMMENT.sub(" ", source).replace("\\\n", " ")
    found = {}
    for kernel, listed in _KERNEL.findall(text):
        arguments = {}
        for argument in ",".join(_expanded(part, text) for part in listed.split(",")).split(","):
            match = _ARGUMENT.fullmatch(argument.strip())
            assert match is not None, f"{kernel}: {argument}"
            arguments[match[2]] = "buffer" if "*" in match[1] else match[1].strip()
        found[kernel] = Signature(kernel, arguments, real)
    return found


def _expanded(argument: str, text: str) -> str:
    """An argument, or those that a macro stands for."""
    name = argument.strip()
    if not name.isidentifier():
        return argument
    definition = re.search(rf"#define {name}[ \t]+([^\n]*)", text)
    assert definition is not None, name
    return definition[1]
