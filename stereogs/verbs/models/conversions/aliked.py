"""ALIKED-n16 (Zhao et al. 2023): keypoints where a score map is largest, descriptors from deformable patches.

Deformable convolutions are bilinear samples followed by a product: ONNX has them from opset 19 only.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .onnx_graph import OnnxGraph

_RADIUS, _TEMPERATURE = 2, 0.1
_MOST, _LEAST_SCORE = 2048, 0.01
_MULTIPLE = 32
_CHANNELS, _SAMPLES = 128, 16
_TINY = 1e-12


def finder(weights: dict[str, Any]) -> bytes:
    """Return a graph from `image` [1, 3, H, W] RGB 0..1, best keypoints first.

    Outputs: `keypoints` [n, 2] (x, y), pixels, first pixel's centre = 0; `descriptors` [n, 128] of unit
    length; `scores` [n]. At most 2,048 keypoints, with scores above 0.01.
    """
    return _Network(weights).content()


class _Network:
    """Writes the network; methods take and return names of values."""

    def __init__(self, weights: dict[str, Any]) -> None:
        self._weights, self._graph = weights, OnnxGraph("aliked")

    def content(self) -> bytes:
        """Write all, and return the file's content."""
        graph = self._graph
        image = graph.input("image", (1, 3, "height", "width"))
        sides = graph("Shape", image, start=2, end=4)
        multiple = self._integers(_MULTIPLE)
        missing = graph("Mod", graph("Sub", multiple, graph("Mod", sides, multiple)), multiple)
        before = graph("Div", missing, self._integers(2))
        none = self._integers(0, 0)
        around = graph("Concat", none, before, none, graph("Sub", missing, before), axis=0)
        features = self._features(graph("Pad", image, around, mode="edge"))
        window = (before, graph("Add", before, sides), self._integers(2, 3))
        scores = graph("Slice", graph("Sigmoid", self._scored(features)), *window)
        features = graph("Slice", self._unit(features), *window)
        self._height, self._width = (
            graph("Squeeze", graph("Shape", image, start=k, end=k + 1)) for k in (2, 3)
        )
        self._last = graph("Cast", graph("Sub", sides, self._integers(1)), to=1)
        self._last = graph("Concat", *(self._row(self._last, k) for k in (1, 0)), axis=0)
        points = self._keypoints(scores)
        # As in the authors' code: from 0..1 to -1..1 and back, so that roundings agree.
        placed = graph("Mul", graph("Div", points, self._last), graph.constant(2.0))
        placed = graph("Sub", placed, graph.constant(1.0))
        at = graph("Reshape", placed, self._integers(1, 1, -1, 2))
        sampled = graph("GridSample", scores, at, align_corners=1)
        halved = graph("Add", graph("Div", placed, graph.constant(2.0)), graph.constant(0.5))
        descriptors = self._descriptors(features, graph("Mul", halved, self._last))
        graph.output("keypoints", points, ("n", 2))
        graph.output("descriptors", descriptors, ("n", _CHANNELS))
        graph.output("scores", graph("Reshape", sampled, self._integers(-1)), ("n",))
        return graph.content()

    def _features(self, image: str) -> str:
        """Features of all levels at the image's size `[1, 128, H, W]`."""
        graph, value, found = self._graph, image, []
        for name in ("conv1", "conv2"):
            value = graph("Selu", self._convolved(value, f"block1.{name}", f"block1.bn{name[-1]}"))
        levels = [value]
        for block, pooled in ((2, 2), (3, 4), (4, 4)):
            value = graph("AveragePool", value, kernel_shape=[pooled] * 2, strides=[pooled] * 2)
            value = self._block(value, f"block{block}", deformed=block > 2)
            levels.append(value)
        for number, (level, factor) in enumerate(zip(levels, (1, 2, 8, 32), strict=True), start=1):
            value = graph("Selu", self._convolved(level, f"conv{number}"))
            if factor > 1:
                factors = graph.constant([1, 1, factor, factor])
                options: Any = {"coordinate_transformation_mode": "align_corners", "mode": "linear"}
                value = graph("Resize", value, "", factors, **options)
            found.append(value)
        return str(graph("Concat", *found, axis=1))

    def _block(self, value: str, name: str, *, deformed: bool) -> str:
        """A residual block."""
        graph, write = self._graph, self._deformed if deformed else self._convolved
        inner = graph("Selu", write(value, f"{name}.conv1", f"{name}.bn1"))
        inner = write(inner, f"{name}.conv2", f"{name}.bn2")
        return str(graph("Selu", graph("Add", inner, self._convolved(value, f"{name}.downsample"))))

    def _deformed(self, value: str, name: str, norm: str) -> str:
        """A 3x3 convolution of samples beside the pixels, by offsets (y, x) that another one predicts."""
        graph = self._graph
        sides = graph("Shape", value, start=2, end=4)
        largest = graph("Cast", graph("ReduceMax", sides, keepdims=0), to=1)
        moved = self._limited(self._convolved(value, f"{name}.offset_conv"), largest)
        moved = graph("Reshape", moved, graph("Concat", self._integers(1, 9, 2), sides, axis=0))
        taps = np.stack(np.divmod(np.arange(9), 3)) - 1
        grid = []
        for axis, shape in ((1, (1, 1, 1, -1)), (0, (1, 1, -1, 1))):
            size = self._row(sides, axis)
            place = graph("Reshape", self._counted(graph("Squeeze", size)), self._integers(*shape))
            offset = graph("Gather", moved, graph.constant(axis, np.int64), axis=2)
            tap = graph.constant(taps[axis].reshape(1, 9, 1, 1))
            place = graph("Add", graph("Add", offset, place), tap)
            doubled = graph("Add", graph("Mul", place, graph.constant(2.0)), graph.constant(1.0))
            share = graph("Div", doubled, graph("Cast", size, to=1))
            share = graph("Sub", share, graph.constant(1.0))
            grid.append(graph("Reshape", share, self._integers(1, -1, 1, 1)))
        samples = graph("GridSample", value, graph("Concat", *grid, axis=3), align_corners=0)
        kernel, bias = self._normed(self._weights[f"{name}.regular_conv.weight"], None, norm)
        count = self._integers(1, kernel.shape[1] * 9)
        samples = graph("Reshape", samples, graph("Concat", count, sides, axis=0))
        flat = graph.constant(kernel.reshape(len(kernel), -1, 1, 1))
        return str(graph("Conv", samples, flat, graph.constant(bias)))

    def _scored(self, features: str) -> str:
        value = self._convolved(features, "score_head.0")
        for layer in (2, 4, 6):
            value = self._convolved(self._graph("Selu", value), f"score_head.{layer}")
        return value

    def _keypoints(self, scores: str) -> str:
        """Positions `[n, 2]` (x, y) of local maxima, moved to the mean of the scores around them."""
        graph = self._graph
        best = self._local_maxima(scores)
        begin, end = (self._integers(k, k) for k in (_RADIUS, -_RADIUS))
        inner = graph("Slice", best, begin, end, self._integers(2, 3))
        border = self._integers(*(0, 0, _RADIUS, _RADIUS) * 2)
        flat = graph("Reshape", graph("Pad", inner, border), self._integers(-1))
        enough = graph("Cast", graph("Greater", flat, graph.constant(_LEAST_SCORE)), to=7)
        count = graph("Min", self._integers(_MOST), graph("ReduceSum", enough, keepdims=1))
        _, places = graph("TopK", flat, count, outputs=2)
        around = self._neighbours(range(-_RADIUS, _RADIUS + 1))
        near = graph("Add", graph("Unsqueeze", places, self._integers(1)), around)
        values = graph("Gather", graph("Reshape", scores, self._integers(-1)), near)
        relative = graph("Sub", values, graph("ReduceMax", values, axes=[1], keepdims=1))
        weights = graph("Exp", graph("Div", relative, graph.constant(_TEMPERATURE)))
        total = graph("ReduceSum", weights, self._integers(1), keepdims=1)
        steps, found = np.arange(-_RADIUS, _RADIUS + 1), []
        columns, rows = np.tile(steps, len(steps)), np.repeat(steps, len(steps))
        for operator, offsets in (("Mod", columns), ("Div", rows)):
            moved = graph("Mul", weights, graph.constant(offsets[None]))
            moved = graph("Div", graph("ReduceSum", moved, self._integers(1), keepdims=1), total)
            place = graph("Cast", graph(operator, places, self._width), to=1)
            found.append(graph("Add", graph("Unsqueeze", place, self._integers(1)), moved))
        return str(graph("Concat", *found, axis=1))

    def _local_maxima(self, scores: str) -> str:
        """The scores, 0 where no maximum is; twice, those that appear without the found ones are added."""
        graph, zero = self._graph, self._graph.constant(0.0)
        kept = graph("Equal", scores, self._largest(scores))
        for _ in range(2):
            near = graph("Greater", self._largest(graph("Cast", kept, to=1)), zero)
            rest = graph("Where", near, zero, scores)
            new = graph("And", graph("Equal", rest, self._largest(rest)), graph("Not", near))
            kept = graph("Or", kept, new)
        return str(graph("Where", kept, scores, zero))

    def _largest(self, value: str) -> str:
        side = 2 * _RADIUS + 1
        return str(self._graph("MaxPool", value, kernel_shape=[side] * 2, pads=[_RADIUS] * 4))

    def _descriptors(self, features: str, points: str) -> str:
        """Unit vectors `[n, 128]` from samples of the features around `[n, 2]` points."""
        graph = self._graph
        moved = self._offsets(features, points)
        places = graph("Add", graph("Unsqueeze", points, self._integers(1)), moved)
        share = graph("Div", graph("Mul", places, graph.constant(2.0)), self._last)
        grid = graph("Sub", share, graph.constant(1.0))
        grid = graph("Reshape", grid, self._integers(1, 1, -1, 2))
        samples = graph("GridSample", features, grid, align_corners=1)
        samples = graph("Squeeze", samples, self._integers(0, 2))
        samples = graph("Transpose", samples, perm=[1, 0])
        matrix = self._weights["desc_head.sf_conv.weight"][:, :, 0, 0].T
        samples = graph("Selu", graph("MatMul", samples, graph.constant(matrix)))
        samples = graph("Reshape", samples, self._integers(-1, _SAMPLES * _CHANNELS))
        matrix = self._weights["desc_head.agg_weights"].reshape(-1, _CHANNELS)
        return self._unit(graph("MatMul", samples, graph.constant(matrix)))

    def _offsets(self, features: str, points: str) -> str:
        """Where to sample around the points `[n, 16, 2]`, predicted from 3x3 features."""
        graph, values = self._graph, self._patches(features, points)
        for layer in (0, 2):
            name = f"desc_head.offset_conv.{layer}"
            matrix = self._weights[f"{name}.weight"]
            values = graph("MatMul", values, graph.constant(matrix.reshape(len(matrix), -1).T))
            values = graph("Add", values, graph.constant(self._weights[f"{name}.bias"]))
            values = values if layer else graph("Selu", values)
        longer = graph("Cast", graph("Max", self._height, self._width), to=1)
        moved = graph("Reshape", self._limited(values, longer), self._integers(-1, 2, _SAMPLES))
        return str(graph("Transpose", moved, perm=[0, 2, 1]))

    def _patches(self, features: str, points: str) -> str:
        """The 3x3 features around the points, inside the image `[n, 128 * 9]`."""
        graph = self._graph
        whole = graph("Cast", graph("Cast", points, to=7), to=1)
        corner = graph("Max", graph("Sub", whole, graph.constant(0.5)), graph.constant(0.0))
        last = graph("Sub", self._last, graph.constant(3.0))
        corner = graph("Cast", graph("Min", graph("Floor", corner), last), to=7)
        column, row = graph("Split", corner, outputs=2, axis=1)
        first = graph("Add", graph("Mul", row, self._width), column)
        places = graph("Add", first, self._neighbours(range(3)))
        flat = graph("Reshape", features, self._integers(_CHANNELS, -1))
        values = graph("Transpose", graph("Gather", flat, places, axis=1), perm=[1, 0, 2])
        return str(graph("Reshape", values, self._integers(-1, _CHANNELS * 9)))

    def _neighbours(self, steps: range) -> str:
        """Distances in the flat image to the pixels of a square `[1, k * k]`."""
        graph = self._graph
        rows, columns = (
            graph.constant(np.reshape(steps, shape), np.int64) for shape in ((-1, 1), (1, -1))
        )
        square = graph("Add", graph("Mul", rows, self._width), columns)
        return str(graph("Reshape", square, self._integers(1, -1)))

    def _limited(self, offsets: str, side: str) -> str:
        """Offsets of at most a quarter of the longer side."""
        limit = self._graph("Div", side, self._graph.constant(4.0))
        return str(
            self._graph("Min", self._graph("Max", offsets, self._graph("Neg", limit)), limit)
        )

    def _unit(self, value: str) -> str:
        """Vectors along axis 1, of length 1."""
        graph = self._graph
        squares = graph("ReduceSum", graph("Mul", value, value), self._integers(1))
        length = graph("Max", graph("Sqrt", squares), graph.constant(_TINY))
        return str(graph("Div", value, length))

    def _convolved(self, value: str, name: str, norm: str = "") -> str:
        """A convolution that keeps the size; `norm` follows it."""
        kernel, bias = self._weights[f"{name}.weight"], self._weights.get(f"{name}.bias")
        if norm:
            kernel, bias = self._normed(kernel, bias, norm)
        arrays = [kernel] if bias is None else [kernel, bias]
        pads = [kernel.shape[2] // 2] * 4
        return str(self._graph("Conv", value, *map(self._graph.constant, arrays), pads=pads))

    def _normed(self, kernel: Any, bias: Any, norm: str) -> tuple[Any, Any]:
        """Kernel and bias that include the batch normalization behind them."""
        scale, shift, mean, variance = (
            self._weights[f"{norm}.{key}"]
            for key in ("weight", "bias", "running_mean", "running_var")
        )
        scale = scale / np.sqrt(variance + 1e-5)
        return kernel * scale[:, None, None, None], shift + ((bias or 0) - mean) * scale

    def _counted(self, count: str) -> str:
        """0, 1, ..., below a number."""
        graph = self._graph
        zero, one = (graph.constant(k, np.int64) for k in range(2))
        return str(graph("Cast", graph("Range", zero, count, one), to=1))

    def _row(self, value: str, place: int) -> str:
        return str(self._graph("Slice", value, *(self._integers(k) for k in (place, place + 1, 0))))

    def _integers(self, *numbers: int) -> str:
        return self._graph.constant(numbers, np.int64)
