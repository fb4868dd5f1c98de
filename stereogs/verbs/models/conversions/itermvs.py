"""IterMVS (Wang et al., CVPR 2022) from a checkpoint of FangjinhuaWang/IterMVS.

Features have 1/2, 1/4 and 1/8 of the size (levels 1 to 3). At level 3, 32 depths give the weight of each
source in each pixel, and a hidden state. Four steps of a recurrent unit at 1/4 of the size read the
correlation at a few depths around the last one. Learned weights of 3x3 neighbours enlarge the depth. Depths
are normalized: 1 is near, 0 is far, linear in inverse depth.
"""

from __future__ import annotations

import io
from typing import Any

import numpy as np

from .onnx_graph import OnnxGraph

_GROUPS, _DEPTHS, _BINS, _STEPS, _NEAR_BINS = 8, 32, 256, 4, 4
_CHANNELS = {1: 16, 2: 32, 3: 48}
_OFFSETS: dict[int, list[float]] = {
    1: [-1 / 128, -1 / 384, 1 / 384, 1 / 128],
    2: [-1 / 32, -1 / 96, 1 / 96, 1 / 32],
    3: [-1 / 8, 1 / 8],
}
"""Normalized depths around the last one at which each level is compared."""
_MEAN, _DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
_EPSILON = 1e-5
"""Of batch normalization, and of the sum of weights."""


def convert(content: bytes) -> tuple[bytes, ...]:
    """Return a graph with the inputs and outputs of `family: mvsanywhere`; sides are multiples of 32."""
    import torch

    checkpoint = torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
    weights = {name: tensor.numpy() for name, tensor in checkpoint["model"].items()}
    return (_Network(weights).content(),)


class _Network:
    """Writes the network; methods take and return names of values."""

    def __init__(self, weights: dict[str, Any]) -> None:
        self._weights, self._graph = weights, OnnxGraph("itermvs")
        views, sides = (1, "views"), ("height", "width")
        images = self._graph.input("images", (*views, 3, *sides))
        self._intrinsics = self._graph.input("K", (*views, 3, 3))
        self._poses = self._graph.input("cam_T_world", (*views, 4, 4))
        bounds = self._graph.input("depth_range", (1, 2))
        near, far = (self._graph("Reciprocal", self._sliced(bounds, 1, k, k + 1)) for k in range(2))
        self._farthest = self._graph("Reshape", far, self._integers(1, 1, 1, 1))
        self._range = self._graph("Sub", near, far)
        features = self._features(images)
        self._sources = {k: self._sliced(value, 0, 1, None) for k, value in features.items()}
        self._references = {k: self._sliced(value, 0, 0, 1) for k, value in features.items()}
        self._motion()

    def content(self) -> bytes:
        """Write the rest, and return the file's content."""
        graph = self._graph
        spread = np.linspace(0, 1, _DEPTHS).reshape(1, -1, 1, 1)
        similarity = self._similarity(3, self._references[3], graph.constant(spread), 1.0, _DEPTHS)
        weights = self._source_weights(similarity)
        correlation = self._correlation(similarity, weights, 3)
        self._seen = self._resized(weights, 2)
        at_quarter = {
            1: self._resized(self._references[1], 0.5),
            2: self._references[2],
            3: self._resized(self._references[3], 2),
        }
        value = graph("Relu", self._convolved(correlation, "iter_mvs.update.hidden_init_head.0"))
        value = self._convolved(value, "iter_mvs.update.hidden_init_head.2")
        hidden = graph("Tanh", self._resized(value, 2))
        depth = self._depth(hidden)
        for _ in range(_STEPS):
            around = [depth, *(self._compared(level, at_quarter, depth) for level in _OFFSETS)]
            hidden = self._updated(hidden, graph("Concat", *around, axis=1))
            depth = self._depth(hidden)
        sure = self._head(hidden, "confidence_head", (0, 2))
        confidence = self._resized(graph("Sigmoid", sure), 4)
        graph.output("depth", self._metric(self._enlarged(depth)), (1, 1, "height", "width"))
        graph.output("conf", confidence, (1, 1, "height", "width"))
        return graph.content()

    def _features(self, images: str) -> dict[int, str]:
        """Features of all views, by level, from images in ImageNet's range."""
        graph = self._graph
        mean, deviation = (np.reshape(v, (1, 3, 1, 1)) for v in (_MEAN, _DEVIATION))
        value = graph("Squeeze", images, self._integers(0))
        value = graph("Mul", value, graph.constant(2 * deviation))
        value = graph("Add", value, graph.constant(2 * mean - 1))
        value = graph(
            "Relu", self._convolved(value, "feature_net.conv1.conv", "feature_net.conv1.bn")
        )
        stages = {}
        for level in _CHANNELS:
            value = self._block(value, f"feature_net.layer{level}.0", 2)
            value = stages[level] = self._block(value, f"feature_net.layer{level}.1", 1)
        found = {3: self._convolved(value, "feature_net.output3")}
        for level in (2, 1):
            value = graph(
                "Add",
                self._resized(value, 2),
                self._convolved(stages[level], f"feature_net.inner{level}"),
            )
            found[level] = self._convolved(value, f"feature_net.output{level}")
        return found

    def _block(self, value: str, name: str, stride: int) -> str:
        """A residual block."""
        graph, around = self._graph, value
        if stride > 1:
            path = f"{name}.downsample"
            around = self._convolved(value, f"{path}.conv", f"{path}.bn", stride=stride)
        inner = self._convolved(value, f"{name}.conv1.conv", f"{name}.conv1.bn", stride=stride)
        inner = self._convolved(graph("Relu", inner), f"{name}.conv2.conv", f"{name}.conv2.bn")
        return str(graph("Relu", graph("Add", inner, around)))

    def _motion(self) -> None:
        """Rotations and translations from the first camera to the others, and all intrinsics."""
        graph = self._graph
        poses = graph("Squeeze", self._poses, self._integers(0))
        upper = self._sliced(poses, 1, 0, 3)
        turns, moves = self._sliced(upper, 2, 0, 3), self._sliced(upper, 2, 3, None)
        first = graph("Transpose", self._sliced(turns, 0, 0, 1), perm=[0, 2, 1])
        self._turns = graph("MatMul", self._sliced(turns, 0, 1, None), first)
        moved = graph("MatMul", self._turns, self._sliced(moves, 0, 0, 1))
        self._moves = graph("Sub", self._sliced(moves, 0, 1, None), moved)
        # In the network's grids, the centre of the first pixel is 0.
        half = np.zeros((1, 3, 3))
        half[0, :2, 2] = 0.5
        matrices = graph("Squeeze", self._intrinsics, self._integers(0))
        self._matrices = graph("Sub", matrices, graph.constant(half))

    def _similarity(
        self, level: int, reference: str, normalized: str, step: float, depths: int
    ) -> str:
        """Group-wise correlation `[S, G, D, h, w]` of the sources at normalized depths `[1, D, ...]`.

        Args:
            reference: features of the first view on the grid of the answer.
            step: distance of this grid's pixels on the grid of the level.
        """
        graph, source = self._graph, self._sources[level]
        depth = graph("Unsqueeze", self._metric(normalized), self._integers(0))
        rows, columns = (self._size(reference, axis) for axis in (2, 3))
        grid = self._grid(level, depth, rows, columns, step)
        warped = graph("GridSample", source, grid, align_corners=1)
        shape = (*self._each(_GROUPS, _CHANNELS[level] // _GROUPS, depths), rows, columns)
        warped = graph("Reshape", warped, graph("Concat", self._integers(0), *shape, axis=0))
        shape = (*self._each(1, _GROUPS, _CHANNELS[level] // _GROUPS, 1), rows, columns)
        reference = graph("Reshape", reference, graph("Concat", *shape, axis=0))
        return str(graph("ReduceMean", graph("Mul", warped, reference), axes=[2], keepdims=0))

    def _grid(self, level: int, depth: str, rows: str, columns: str, step: float) -> str:
        """Where the sources show the first view's pixels, `[S, D h w, 1, 2]` for GridSample."""
        graph, scale = self._graph, 1 / 2**level
        matrices = graph("Mul", self._matrices, graph.constant([[[scale]] * 2 + [[1]]]))
        first, others = self._sliced(matrices, 0, 0, 1), self._sliced(matrices, 0, 1, None)
        turn, move = (graph("MatMul", others, value) for value in (self._turns, self._moves))
        rays = []
        for axis, count, shape in ((0, columns, (1, 1, 1, -1)), (1, rows, (1, 1, -1, 1))):
            zero, one = (graph.constant(k, np.int64) for k in range(2))
            numbers = graph("Range", zero, graph("Squeeze", count), one)
            place = graph("Mul", graph("Cast", numbers, to=1), graph.constant(step))
            row = self._sliced(first, 1, axis, axis + 1)
            middle, focal = (
                graph("Reshape", self._sliced(row, 2, k, k + 1), self._integers(1))
                for k in (2, axis)
            )
            ray = graph("Div", graph("Sub", place, middle), focal)
            rays.append(graph("Reshape", ray, self._integers(*shape)))
        terms = [
            graph("Unsqueeze", self._sliced(turn, 2, k, k + 1), self._integers(3)) for k in range(3)
        ]
        seen = [graph("Mul", term, ray) for term, ray in zip(terms, rays, strict=False)]
        direction = graph("Add", graph("Add", *seen), terms[2])
        points = graph("Mul", graph("Unsqueeze", direction, self._integers(2)), depth)
        points = graph("Add", points, graph("Unsqueeze", move, self._integers(3, 4)))
        z = self._sliced(points, 1, 2, 3)
        ahead = graph("Greater", z, graph.constant(0.01))
        places = []
        for axis, dimension in ((0, 3), (1, 2)):
            size = graph("Cast", self._size(self._sources[level], dimension), to=1)
            place = graph("Div", self._sliced(points, 1, axis, axis + 1), z)
            half = graph("Div", graph("Sub", size, graph.constant(1.0)), graph.constant(2.0))
            # What lies behind a source is outside its image.
            place = graph("Div", graph("Where", ahead, place, size), half)
            places.append(graph("Sub", place, graph.constant(1.0)))
        flat = [graph("Reshape", place, self._integers(0, -1, 1, 1)) for place in places]
        return str(graph("Concat", *flat, axis=3))

    def _source_weights(self, similarity: str) -> str:
        """How much each source counts in each pixel, `[S, 1, h, w]`."""
        graph = self._graph
        value = graph("Transpose", similarity, perm=[0, 2, 1, 3, 4])
        sides = (self._size(similarity, 3), self._size(similarity, 4))
        value = graph("Reshape", value, graph("Concat", *self._each(-1, _GROUPS), *sides, axis=0))
        name = "iter_mvs.evaluation.pixel_view_weight.conv"
        value = self._convolved(
            graph("Relu", self._convolved(value, f"{name}.0.conv")), f"{name}.1"
        )
        value = graph("Reshape", value, graph("Concat", *self._each(-1, _DEPTHS), *sides, axis=0))
        return str(graph("ReduceMax", graph("Softmax", value, axis=1), axes=[1], keepdims=1))

    def _correlation(self, similarity: str, weights: str, level: int) -> str:
        """The weighted mean of the similarities, reduced to a number for each depth `[1, D, h, w]`."""
        graph, sources = self._graph, self._integers(0)
        weights = graph("Unsqueeze", weights, self._integers(2))
        total = graph("ReduceSum", graph("Mul", similarity, weights), sources, keepdims=0)
        count = graph("ReduceSum", weights, sources, keepdims=0)
        mean = graph("Div", total, graph("Add", count, graph.constant(_EPSILON)))
        value = graph("Transpose", mean, perm=[1, 0, 2, 3])
        name = f"iter_mvs.evaluation.corr_conv1.{level - 1}.conv"
        full = graph("Relu", self._convolved(value, f"{name}0.conv"))
        half = graph("Relu", self._convolved(full, f"{name}1.conv", stride=2))
        quarter = graph("Relu", self._convolved(half, f"{name}2.conv", stride=2))
        half = graph("Add", half, self._transposed(quarter, f"{name}3"))
        full = graph("Add", full, self._transposed(half, f"{name}4"))
        return str(graph("Transpose", self._convolved(full, f"{name}5"), perm=[1, 0, 2, 3]))

    def _compared(self, level: int, references: dict[int, str], depth: str) -> str:
        graph, offsets = self._graph, _OFFSETS[level]
        around = graph("Add", depth, graph.constant(np.reshape(offsets, (1, -1, 1, 1))))
        around = graph("Clip", around, graph.constant(0.0), graph.constant(1.0))
        step = 2.0 ** (2 - level)
        similarity = self._similarity(level, references[level], around, step, len(offsets))
        return self._correlation(similarity, self._seen, level)

    def _updated(self, hidden: str, around: str) -> str:
        """A step of the gated recurrent unit."""
        graph, name = self._graph, "iter_mvs.update.gru.conv"
        both = graph("Concat", hidden, around, axis=1)
        update, reset = (
            graph("Sigmoid", self._convolved(both, f"{name}{gate}", dilation=2)) for gate in "zr"
        )
        both = graph("Concat", graph("Mul", reset, hidden), around, axis=1)
        new = graph("Tanh", self._convolved(both, f"{name}q", dilation=2))
        kept = graph("Mul", graph("Sub", graph.constant(1.0), update), hidden)
        return str(graph("Add", kept, graph("Mul", update, new)))

    def _depth(self, hidden: str) -> str:
        """Normalized depth `[1, 1, h, w]`: the mean of the bins around the likeliest."""
        graph = self._graph
        likely = graph("Softmax", self._head(hidden, "depth_head", (0, 2, 4)), axis=1)
        best = graph("ArgMax", likely, axis=1, keepdims=1)
        near = np.arange(-_NEAR_BINS, _NEAR_BINS + 1).reshape(1, -1, 1, 1)
        bins = graph("Add", best, graph.constant(near, np.int64))
        last = [graph.constant(k, np.int64) for k in (0, _BINS - 1)]
        bins = graph("Clip", bins, *last)
        chosen = graph("GatherElements", likely, bins, axis=1)
        weighted = graph("Mul", graph("Cast", bins, to=1), chosen)
        total, count = (
            graph("ReduceSum", value, self._integers(1)) for value in (weighted, chosen)
        )
        mean = graph("Div", total, graph("Add", count, graph.constant(1e-6)))
        return str(graph("Div", mean, graph.constant(float(_BINS - 1))))

    def _head(self, value: str, name: str, layers: tuple[int, ...]) -> str:
        for layer in layers:
            if layer:
                value = self._graph("Relu", value)
            dilation = 1 if layer else 2
            value = self._convolved(value, f"iter_mvs.update.{name}.{layer}", dilation=dilation)
        return value

    def _enlarged(self, depth: str) -> str:
        """Depth `[1, 1, 4 h, 4 w]`: weighted means of 3x3 neighbours."""
        graph, reference = self._graph, self._references[2]
        rows, columns = (self._size(reference, axis) for axis in (2, 3))
        value = graph("Relu", self._convolved(reference, "iter_mvs.upsample.0"))
        value = self._convolved(value, "iter_mvs.upsample.2")
        shape = graph("Concat", *self._each(1, 9, 16), rows, columns, axis=0)
        weights = graph("Softmax", graph("Reshape", value, shape), axis=1)
        padded = graph("Pad", depth, self._integers(0, 0, 1, 1, 0, 0, 1, 1), mode="edge")
        ends = [graph("Concat", rows, columns, axis=0)]
        ends += [graph("Add", ends[0], self._integers(y, x)) for y in range(3) for x in range(3)]
        shifted = [
            graph("Slice", padded, self._integers(k // 3, k % 3), end, self._integers(2, 3))
            for k, end in enumerate(ends[1:])
        ]
        around = graph("Unsqueeze", graph("Concat", *shifted, axis=1), self._integers(2))
        mean = graph("ReduceSum", graph("Mul", around, weights), self._integers(1), keepdims=0)
        return str(graph("DepthToSpace", mean, blocksize=4, mode="CRD"))

    def _metric(self, normalized: str) -> str:
        inverse = self._graph("Mul", normalized, self._range)
        return str(self._graph("Reciprocal", self._graph("Add", self._farthest, inverse)))

    def _convolved(
        self, value: str, name: str, norm: str = "", *, stride: int = 1, dilation: int = 1
    ) -> str:
        """A convolution that keeps the size, or divides it by the stride; `norm` follows it."""
        kernel = self._weights[f"module.{name}.weight"]
        bias = self._weights.get(f"module.{name}.bias")
        if norm:
            scale, bias, mean, variance = (
                self._weights[f"module.{norm}.{key}"]
                for key in ("weight", "bias", "running_mean", "running_var")
            )
            scale = scale / np.sqrt(variance + _EPSILON)
            kernel, bias = kernel * scale[:, None, None, None], bias - mean * scale
        arrays = [kernel] if bias is None else [kernel, bias]
        return str(
            self._graph(
                "Conv",
                *(value, *map(self._graph.constant, arrays)),
                strides=[stride] * 2,
                dilations=[dilation] * 2,
                pads=[dilation * (kernel.shape[2] // 2)] * 4,
            )
        )

    def _transposed(self, value: str, name: str) -> str:
        kernel = self._graph.constant(self._weights[f"module.{name}.weight"])
        sides: dict[str, Any] = {"strides": [2, 2], "pads": [1] * 4, "output_padding": [1, 1]}
        return str(self._graph("ConvTranspose", value, kernel, **sides))

    def _resized(self, value: str, factor: float) -> str:
        factors = self._graph.constant([1, 1, factor, factor])
        return str(self._graph("Resize", value, "", factors, mode="linear"))

    def _sliced(self, value: str, axis: int, begin: int, end: int | None) -> str:
        last = np.iinfo(np.int64).max if end is None else end
        return str(self._graph("Slice", value, *(self._integers(n) for n in (begin, last, axis))))

    def _size(self, value: str, axis: int) -> str:
        """One number `[1]`."""
        return str(self._graph("Shape", value, start=axis, end=axis + 1))

    def _integers(self, *numbers: int) -> str:
        return self._graph.constant(numbers, np.int64)

    def _each(self, *numbers: int) -> list[str]:
        return [self._integers(number) for number in numbers]
