"""Write ONNX graphs node by node."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from registry.toolkit.optional_package import optional_module

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

OPSET, IR_VERSION = 17, 8


class OnnxGraph:
    """A graph under construction; values are referenced by name.

    Raises:
        PluginError: the package `onnx` is not installed.
    """

    def __init__(self, name: str) -> None:
        onnx = optional_module("onnx", "pip install 'stereogs-plugins[convert]'", then="")
        self._onnx, self._helper, self._name = onnx, onnx.helper, name
        self._nodes: list[Any] = []
        self._constants: list[Any] = []
        self._names: dict[tuple[type, tuple[int, ...], bytes], str] = {}
        self._inputs: list[Any] = []
        self._outputs: list[Any] = []

    def input(self, name: str, shape: Sequence[int | str]) -> str:
        """Add a float32 input."""
        self._inputs.append(self._described(name, shape))
        return name

    def output(
        self, name: str, value: str, shape: Sequence[int | str], kind: str = "FLOAT"
    ) -> None:
        """Return a value from the graph, under this name."""
        self._nodes.append(self._helper.make_node("Identity", [value], [name]))
        self._outputs.append(self._described(name, shape, kind))

    def constant(self, values: object, dtype: type = np.float32) -> str:
        """Add numbers of any shape; equal ones are stored once."""
        array: NDArray[Any] = np.array(values, dtype, order="C")
        key = (dtype, array.shape, array.tobytes())
        if key not in self._names:
            self._names[key] = f"constant{len(self._names)}"
            self._constants.append(self._onnx.numpy_helper.from_array(array, self._names[key]))
        return self._names[key]

    def half(self, values: NDArray[np.float32]) -> str:
        """Add numbers that are stored as float16 and used as float32."""
        return str(self("Cast", self.constant(values, np.float16), to=self._onnx.TensorProto.FLOAT))

    def __call__(self, operator: str, *inputs: str, outputs: int = 0, **attributes: Any) -> Any:
        """Add a node; return its output, or with `outputs` a list of that many."""
        number = len(self._nodes)
        names = [f"value{number}_{k}" for k in range(outputs)] or [f"value{number}"]
        self._nodes.append(self._helper.make_node(operator, inputs, names, **attributes))
        return names if outputs else names[0]

    def content(self) -> bytes:
        """Return the file's content, checked by the package `onnx`."""
        graph = self._helper.make_graph(
            self._nodes, self._name, self._inputs, self._outputs, self._constants
        )
        versions = [self._helper.make_opsetid("", OPSET)]
        model = self._helper.make_model(graph, opset_imports=versions, ir_version=IR_VERSION)
        self._onnx.checker.check_model(model, full_check=True)
        return bytes(model.SerializeToString())

    def _described(self, name: str, shape: Sequence[int | str], kind: str = "FLOAT") -> Any:
        number = getattr(self._onnx.TensorProto, kind)
        return self._helper.make_tensor_value_info(name, number, list(shape))
