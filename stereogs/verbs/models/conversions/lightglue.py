"""LightGlue (Lindenberger et al., ICCV 2023) for ALIKED: nine layers of attention, without early stopping."""

from __future__ import annotations

from typing import Any

import numpy as np

from .onnx_graph import OnnxGraph

_LAYERS, _HEADS, _WIDTH = 9, 4, 256
_SIZE = _WIDTH // _HEADS
"""Channels of a head."""


def matcher(weights: dict[str, Any]) -> bytes:
    """Return a graph that matches keypoints, with matrices stored as float16.

    Inputs: `kpts0`, `kpts1` [1, n, 2], longer side of the image from -1 to 1; `desc0`, `desc1` [1, n, 128].
    Outputs: `matches` [m, 2] of all mutual best pairs, `scores` [m].
    """
    return _Network(weights).content()


class _Network:
    """Writes the network; methods take and return names of values."""

    def __init__(self, weights: dict[str, Any]) -> None:
        self._weights, self._graph = weights, OnnxGraph("lightglue")
        self._halves: dict[str, str] = {}

    def content(self) -> bytes:
        """Write all, and return the file's content."""
        graph = self._graph
        places = [graph.input(f"kpts{k}", (1, f"n{k}", 2)) for k in range(2)]
        found = [graph.input(f"desc{k}", (1, f"n{k}", 128)) for k in range(2)]
        wave = graph.constant(self._weights["posenc.Wr.weight"].T)
        angles = [
            graph("Unsqueeze", graph("MatMul", place, wave), self._integers(1)) for place in places
        ]
        turns = [(graph("Cos", angle), graph("Sin", angle)) for angle in angles]
        values = [self._linear(value, "input_proj") for value in found]
        for layer in range(_LAYERS):
            name = f"transformers.{layer}"
            values = [
                self._within(value, turn, f"{name}.self_attn")
                for value, turn in zip(values, turns, strict=True)
            ]
            values = self._across(values, f"{name}.cross_attn")
        self._matches(self._assignment(values, f"log_assignment.{_LAYERS - 1}"))
        return graph.content()

    def _within(self, value: str, turn: tuple[str, str], name: str) -> str:
        """Self-attention with rotary positions."""
        # Rows are ordered by head, channel, and query, key or value; channels turn in pairs. Queries and
        # keys get the first channels of all pairs, then the second; this order does not change their product.
        matrix = self._weights[f"{name}.Wqkv.weight"].reshape(_HEADS, _SIZE, 3, _WIDTH)
        bias = self._weights[f"{name}.Wqkv.bias"].reshape(_HEADS, _SIZE, 3)
        paired = [*range(0, _SIZE, 2), *range(1, _SIZE, 2)]
        parts = []
        for place, order in enumerate((paired, paired, range(_SIZE))):
            rows = matrix[:, list(order), place].reshape(_WIDTH, _WIDTH)
            part = self._product(value, f"{name}.{place}", rows)
            added = self._graph.constant(bias[:, list(order), place].ravel())
            parts.append(self._heads(self._graph("Add", part, added)))
        query, key = (self._turned(part, turn) for part in parts[:2])
        message = self._attended(query, key, parts[2])
        return self._updated(value, self._linear(message, f"{name}.out_proj"), name)

    def _turned(self, value: str, turn: tuple[str, str]) -> str:
        graph, (cosine, sine) = self._graph, turn
        first, second = graph("Split", value, outputs=2, axis=3)
        turned = (
            graph("Sub", graph("Mul", first, cosine), graph("Mul", second, sine)),
            graph("Add", graph("Mul", second, cosine), graph("Mul", first, sine)),
        )
        return str(graph("Concat", *turned, axis=3))

    def _across(self, values: list[str], name: str) -> list[str]:
        """Attention of each image's keypoints to those of the other."""
        keys = [self._heads(self._linear(value, f"{name}.to_qk")) for value in values]
        contents = [self._heads(self._linear(value, f"{name}.to_v")) for value in values]
        messages = [self._attended(keys[k], keys[1 - k], contents[1 - k]) for k in range(2)]
        return [
            self._updated(value, self._linear(message, f"{name}.to_out"), name)
            for value, message in zip(values, messages, strict=True)
        ]

    def _attended(self, query: str, key: str, content: str) -> str:
        graph = self._graph
        product = graph("MatMul", query, graph("Transpose", key, perm=[0, 1, 3, 2]))
        scaled = graph("Mul", product, graph.constant(_SIZE**-0.5))
        mean = graph("MatMul", graph("Softmax", scaled, axis=-1), content)
        joined = graph("Transpose", mean, perm=[0, 2, 1, 3])
        return str(graph("Reshape", joined, self._integers(1, -1, _WIDTH)))

    def _updated(self, value: str, message: str, name: str) -> str:
        """Add a two-layer network of value and message to the value."""
        graph = self._graph
        inner = self._linear(graph("Concat", value, message, axis=-1), f"{name}.ffn.0")
        norm = [graph.constant(self._weights[f"{name}.ffn.1.{k}"]) for k in ("weight", "bias")]
        inner = graph("LayerNormalization", inner, *norm, axis=-1)
        error = graph("Erf", graph("Div", inner, graph.constant(np.sqrt(2))))
        share = graph("Mul", graph("Add", error, graph.constant(1.0)), graph.constant(0.5))
        gelu = graph("Mul", inner, share)
        return str(graph("Add", value, self._linear(gelu, f"{name}.ffn.3")))

    def _assignment(self, values: list[str], name: str) -> str:
        """Logarithm of the probability of each pair, `[n0, n1]`."""
        graph = self._graph
        scale = graph.constant(_WIDTH**0.25)
        first, second = (graph("Div", self._linear(v, f"{name}.final_proj"), scale) for v in values)
        product = graph("MatMul", first, graph("Transpose", second, perm=[0, 2, 1]))
        total = graph("Add", *(graph("LogSoftmax", product, axis=axis) for axis in (2, 1)))
        for value, order in zip(values, ([0, 1, 2], [0, 2, 1]), strict=True):
            likely = graph("Sigmoid", self._linear(value, f"{name}.matchability", half=False))
            total = graph("Add", total, graph("Transpose", graph("Log", likely), perm=order))
        return str(graph("Squeeze", total, self._integers(0)))

    def _matches(self, scores: str) -> None:
        graph = self._graph
        there, back = (graph("ArgMax", scores, axis=axis, keepdims=0) for axis in (1, 0))
        count = graph("Squeeze", graph("Shape", there))
        numbers = graph("Range", *(graph.constant(0, np.int64), count, graph.constant(1, np.int64)))
        mutual = graph("Equal", graph("Gather", back, there), numbers)
        first = graph("Squeeze", graph("NonZero", mutual), self._integers(0))
        pair = [
            graph("Unsqueeze", k, self._integers(1)) for k in (first, graph("Gather", there, first))
        ]
        best = graph("Gather", graph("ReduceMax", scores, axes=[1], keepdims=0), first)
        graph.output("matches", graph("Concat", *pair, axis=1), ("m", 2), "INT64")
        graph.output("scores", graph("Exp", best), ("m",))

    def _heads(self, value: str) -> str:
        """`[1, heads, n, channels]`."""
        split = self._graph("Reshape", value, self._integers(1, -1, _HEADS, _SIZE))
        return str(self._graph("Transpose", split, perm=[0, 2, 1, 3]))

    def _linear(self, value: str, name: str, *, half: bool = True) -> str:
        matrix, bias = (self._weights[f"{name}.{key}"] for key in ("weight", "bias"))
        product = self._product(value, name, matrix, half=half)
        return str(self._graph("Add", product, self._graph.constant(bias)))

    def _product(self, value: str, name: str, matrix: Any, *, half: bool = True) -> str:
        if name not in self._halves:
            store = self._graph.half if half else self._graph.constant
            self._halves[name] = store(matrix.T)
        return str(self._graph("MatMul", value, self._halves[name]))

    def _integers(self, *numbers: int) -> str:
        return self._graph.constant(numbers, np.int64)
