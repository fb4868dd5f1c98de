"""Tiny ONNX graphs of plain operators with the signatures of real networks and known outputs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper
from torch import Tensor

FLOAT, HALF, BYTE = TensorProto.FLOAT, TensorProto.FLOAT16, TensorProto.UINT8
Shape = Sequence[int | str]
OPEN: Shape = ("N", 3, "H", "W")


class Graph:
    """Builder of an ONNX graph; values are referenced by name."""

    def __init__(self) -> None:
        self._nodes: list[onnx.NodeProto] = []
        self._constants: list[onnx.TensorProto] = []
        self._inputs: list[onnx.ValueInfoProto] = []
        self._outputs: list[onnx.ValueInfoProto] = []

    def input(self, name: str, shape: Shape, kind: int = FLOAT) -> str:
        """An input; used inside as float32."""
        self._inputs.append(helper.make_tensor_value_info(name, kind, shape))
        return self("Cast", name, to=FLOAT)

    def output(self, name: str, value: str, shape: Shape, kind: int = FLOAT) -> None:
        """A value as output."""
        self._nodes.append(helper.make_node("Cast", [value], [name], to=kind))
        self._outputs.append(helper.make_tensor_value_info(name, kind, shape))

    def constant(self, values: object, dtype: type = np.float32) -> str:
        """Numbers, of any shape."""
        name = f"constant{len(self._constants)}"
        self._constants.append(numpy_helper.from_array(np.array(values, dtype), name))
        return name

    def __call__(self, operator: str, *inputs: str, **attributes: Any) -> str:
        """The first output of a new node."""
        name = f"value{len(self._nodes)}"
        self._nodes.append(helper.make_node(operator, inputs, [name], **attributes))
        return name

    def slice(self, value: str, axis: int, start: int, end: int) -> str:
        """`value[start:end]` along an axis."""
        return self("Slice", value, *(self.constant([n], np.int64) for n in (start, end, axis)))

    def largest(self, value: str, count: int) -> tuple[str, str]:
        """The largest values along the last axis, sorted, and where they are."""
        names = (f"value{len(self._nodes)}", f"place{len(self._nodes)}")
        limit = self.constant([count], np.int64)
        self._nodes.append(helper.make_node("TopK", [value, limit], names))
        return names

    def save(self, path: Path) -> Path:
        """Write the file; onnx's own checker agrees with it."""
        graph = helper.make_graph(self._nodes, "tiny", self._inputs, self._outputs, self._constants)
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=10)
        onnx.checker.check_model(model, full_check=True)
        path.write_bytes(model.SerializeToString())
        return path


def block_matcher(graph: Graph, left: str, right: str, candidates: int) -> str:
    """Disparity `[N, 1, H, W]`: the shift of least absolute difference over 5x5 pixels."""
    outside = graph.constant(1e5)
    costs = []
    for shift in range(candidates):
        moved = right
        if shift:
            pads = graph.constant([0, 0, 0, shift, 0, 0, 0, 0], np.int64)
            moved = graph("Pad", graph.slice(right, 3, 0, -shift), pads, outside)
        difference = graph("Abs", graph("Sub", left, moved))
        cost = graph("ReduceMean", difference, axes=[1], keepdims=1)
        costs.append(graph("AveragePool", cost, kernel_shape=[5, 5], pads=[2, 2, 2, 2]))
    best = graph("ArgMin", graph("Concat", *costs, axis=1), axis=1, keepdims=1)
    return graph("Cast", best, to=FLOAT)


def constant_map(graph: Graph, image: str, value: float) -> str:
    """`[N, 1, H, W]` of one number."""
    nothing = graph("Mul", graph.slice(image, 1, 0, 1), graph.constant(0.0))
    return graph("Add", nothing, graph.constant(value))


def matcher(
    path: Path,
    names: tuple[str, str, str] = ("left", "right", "disp"),
    *,
    shape: Shape = OPEN,
    kind: int = FLOAT,
    output_kind: int = FLOAT,
    candidates: int = 12,
    sign: float = 1.0,
    multiple: int = 1,
) -> Path:
    """A block matcher as a stereo network with any names, sizes and types.

    Args:
        multiple: other sides fail in a Concat, as in networks that join levels of a pyramid.
    """
    graph = Graph()
    left, right = (graph.input(name, shape, kind) for name in names[:2])
    if multiple > 1:
        small = graph("AveragePool", left, kernel_shape=[multiple] * 2, strides=[multiple] * 2)
        level = graph("Resize", small, "", graph.constant([1, 1, multiple, multiple]))
        left = graph.slice(graph("Concat", left, level, axis=1), 1, 0, 3)
    disparity = block_matcher(graph, left, right, candidates)
    signed = graph("Mul", disparity, graph.constant(sign))
    graph.output(names[2], signed, [shape[0], 1, *shape[2:]], output_kind)
    return graph.save(path)


def stacked_matcher(
    path: Path, channels: int, *, channels_last: bool, batch: int | str = 1
) -> Path:
    """A block matcher whose one input holds both images; only its first channel of each counts."""
    graph = Graph()
    pair = graph.input("input", (batch, channels, "H", "W"))
    half = channels // 2
    left, right = (graph.slice(pair, 1, start, start + 1) for start in (0, half))
    disparity = block_matcher(graph, left, right, 12)
    if channels_last:
        disparity = graph("Transpose", disparity, perm=[0, 2, 3, 1])
    shape = (batch, "H", "W", 1) if channels_last else (batch, 1, "H", "W")
    graph.output("reference_output_disparity", disparity, shape)
    return graph.save(path)


def stacked_echo(path: Path, channels: int, channel: int) -> Path:
    """One channel of a stacked pair as disparity."""
    graph = Graph()
    pair = graph.input("input", (1, channels, "H", "W"))
    graph.output("disparity", graph.slice(pair, 1, channel, channel + 1), (1, 1, "H", "W"))
    return graph.save(path)


def constant_shift(path: Path, value: float, shape: Shape = OPEN) -> Path:
    """One disparity everywhere."""
    graph = Graph()
    left, _ = graph.input("left", shape), graph.input("right", shape)
    graph.output("disp", constant_map(graph, left, value), [shape[0], 1, *shape[2:]])
    return graph.save(path)


def echo(
    path: Path,
    shape: Shape = OPEN,
    kind: int = FLOAT,
    names: tuple[str, str, str] = ("left", "right", "disp"),
) -> Path:
    """The left image's red channel as disparity."""
    graph = Graph()
    left, _ = (graph.input(name, shape, kind) for name in names[:2])
    graph.output(names[2], graph.slice(left, 1, 0, 1), [shape[0], 1, *shape[2:]])
    return graph.save(path)


def quarter_size(path: Path) -> Path:
    """A disparity at a quarter of the image's size."""
    graph = Graph()
    left, _ = graph.input("left", OPEN), graph.input("right", OPEN)
    small = graph("AveragePool", left, kernel_shape=[4, 4], strides=[4, 4])
    graph.output("disp", graph.slice(small, 1, 0, 1), ["N", 1, "h", "w"])
    return graph.save(path)


def s2m2(path: Path, height: int, width: int) -> Path:
    """uint8 inputs; visible where the left image is not black, confidence is its green / 255."""
    graph = Graph()
    shape = (1, 3, height, width)
    left, right = (graph.input(f"input_{side}", shape, BYTE) for side in ("left", "right"))
    bright = graph("Greater", graph("ReduceMax", left, axes=[1], keepdims=1), graph.constant(0.0))
    answers = {
        "output_disp": block_matcher(graph, left, right, 12),
        "output_occ": graph("Cast", bright, to=FLOAT),
        "output_conf": graph("Div", graph.slice(left, 1, 1, 2), graph.constant(255.0)),
    }
    for name, value in answers.items():
        graph.output(name, value, (1, 1, height, width))
    return graph.save(path)


def raft_stereo(path: Path) -> Path:
    """Flow at a quarter and at full size; the flow along x is minus the disparity."""
    graph = Graph()
    left, right = graph.input("image1", OPEN), graph.input("image2", OPEN)
    flow = graph("Neg", block_matcher(graph, left, right, 12))
    small = graph("AveragePool", flow, kernel_shape=[4, 4], strides=[4, 4])
    graph.output("flow_low", small, ["N", 1, "h", "w"])
    graph.output("flow_up", flow, ["N", 1, "H", "W"])
    return graph.save(path)


def feature_pair(folder: Path, height: int, width: int, candidates: int = 4) -> tuple[Path, Path]:
    """Features (each 4x4 block of pixels, 48 channels), and the best candidate of their volume."""
    first = Graph()
    shape = (1, 3, height, width)
    images = {side: first.input(side, shape) for side in ("left", "right")}
    centered = {side: first("Sub", image, first.constant(127.5)) for side, image in images.items()}
    sizes: dict[str, Shape] = {}
    for side, image in centered.items():
        name = f"features_{side}_04"
        sizes[name] = (1, 48, height // 4, width // 4)
        first.output(name, first("SpaceToDepth", image, blocksize=4), sizes[name])
    for name, step in {
        "features_left_08": 8,
        "features_left_16": 16,
        "features_left_32": 32,
        "stem_2x": 2,
    }.items():
        pooled = first(
            "AveragePool", images["left"], kernel_shape=[step, step], strides=[step, step]
        )
        sizes[name] = (1, 3, height // step, width // step)
        first.output(name, pooled, sizes[name])

    second = Graph()
    passed = {name: second.input(name, size) for name, size in sizes.items()}
    volume = second.input("gwc_volume", (1, 8, candidates, height // 4, width // 4))
    mean = second("ReduceMean", volume, axes=[1], keepdims=0)
    best = second("Cast", second("ArgMax", mean, axis=1, keepdims=1), to=FLOAT)
    large = second("Resize", best, "", second.constant([1, 1, 4, 4]), mode="nearest")
    disparity = second("Mul", large, second.constant(4.0))
    # What the first graph passes on takes part: it must arrive unchanged.
    stem = second("ReduceMean", passed["stem_2x"], axes=[0, 1, 2, 3], keepdims=0)
    finest = second("ReduceMean", passed["features_left_32"], axes=[0, 1, 2, 3], keepdims=0)
    second.output(
        "disp", second("Add", disparity, second("Sub", stem, finest)), (1, 1, height, width)
    )
    return first.save(folder / "first.onnx"), second.save(folder / "second.onnx")


def pick(
    path: Path,
    name: str,
    index: Sequence[int],
    *,
    views: int | str = "V",
    depth_range: bool = True,
    confidence: float | None = 0.5,
    shrink: int = 1,
) -> Path:
    """A multi-view network whose depth, everywhere, is one number of one input.

    `images` answers that view's and channel's picture instead. The confidence is one number, too.
    """
    graph = Graph()
    shapes: dict[str, Shape] = {
        "images": (1, views, 3, "H", "W"),
        "K": (1, views, 3, 3),
        "cam_T_world": (1, views, 4, 4),
    }
    if depth_range:
        shapes["depth_range"] = (1, 2)
    return _pick(graph, path, shapes, name, index, ("depth", "conf"), confidence, shrink)


def mean_of_sources(path: Path, counted: int | None, *, seen: int = 100) -> Path:
    """A multi-view network whose depth is 2 plus the mean red of the sources, of the first `seen` ones.

    Args:
        counted: divide by this number of sources, as an export with it as a constant does; None: by the true
            number.
    """
    graph = Graph()
    images = graph.input("images", (1, "V", 3, "H", "W"))
    cameras = [graph.input(name, (1, "V", n, n)) for name, n in (("K", 3), ("cam_T_world", 4))]
    red = graph("Squeeze", graph.slice(images, 2, 0, 1), graph.constant([2], np.int64))
    sources = graph.slice(red, 1, 1, 1 + seen)
    if counted is None:
        mean = graph("ReduceMean", sources, axes=[1])
    else:
        total = graph("ReduceSum", sources, graph.constant([1], np.int64))
        mean = graph("Div", total, graph.constant(float(counted)))
    for camera in cameras:  # an unused input would be removed
        mean = graph("Add", mean, graph("Mul", graph("ReduceMax", camera), graph.constant(0.0)))
    graph.output("depth", graph("Add", mean, graph.constant(2.0)), (1, 1, "H", "W"))
    return graph.save(path)


def pick_staged(path: Path, name: str, index: Sequence[int]) -> Path:
    """The same in MVSFormer's form."""
    shapes: dict[str, Shape] = {
        "imgs": (1, "V", 3, "H", "W"),
        **{f"stage{stage}": (1, "V", 2, 4, 4) for stage in (1, 2, 3, 4)},
        "depth_values": (1, 192),
    }
    outputs = ("refined_depth", "photometric_confidence")
    return _pick(Graph(), path, shapes, name, index, outputs, 0.5)


def _pick(
    graph: Graph,
    path: Path,
    shapes: dict[str, Shape],
    name: str,
    index: Sequence[int],
    outputs: tuple[str, str],
    confidence: float | None,
    shrink: int = 1,
) -> Path:
    values = {key: graph.input(key, shape) for key, shape in shapes.items()}
    chosen = values[name]
    for axis, place in enumerate(index, start=1):
        chosen = graph.slice(chosen, axis, place, place + 1)
    images = values[next(iter(shapes))]
    plane = graph.slice(graph.slice(images, 1, 0, 1), 2, 0, 1)
    flat = graph.constant([1], np.int64)
    plane = graph("Squeeze", plane, flat)  # [1, 1, H, W]
    nothing = graph("Mul", plane, graph.constant(0.0))
    if name == next(iter(shapes)):
        answer = graph("Squeeze", chosen, flat)
    else:
        scalar = graph("Reshape", chosen, graph.constant([1, 1, 1, 1], np.int64))
        answer = graph("Add", nothing, scalar)
    answer = graph("AveragePool", answer, kernel_shape=[shrink] * 2, strides=[shrink] * 2)
    graph.output(outputs[0], answer, (1, 1, "h", "w"))
    if confidence is not None:
        certain = graph("Add", nothing, graph.constant(confidence))
        graph.output(outputs[1], certain, (1, 1, "H", "W"))
    return graph.save(path)


def mono(
    path: Path,
    name: str = "image",
    *,
    shape: Shape = (1, 3, "H", "W"),
    shrink: int = 1,
    offset: float = 10.0,
) -> Path:
    """The image's red numbers plus an offset as inverse depth, at 1 / shrink of the size."""
    graph = Graph()
    image = graph.input(name, shape)
    red = graph("Add", graph.slice(image, 1, 0, 1), graph.constant(offset))
    small = graph("AveragePool", red, kernel_shape=[shrink] * 2, strides=[shrink] * 2)
    graph.output("depth", graph("Squeeze", small, graph.constant([1], np.int64)), (1, "h", "w"))
    return graph.save(path)


def grey_features(path: Path, *, shrink: int = 1, offset: float = 1.0) -> Path:
    """Two features of a grey image g: (g, 2 g + offset)."""
    graph = Graph()
    grey = graph.input("gray", ("N", 1, "H", "W"))
    second = graph("Add", graph("Mul", grey, graph.constant(2.0)), graph.constant(offset))
    both = graph("Concat", grey, second, axis=1)
    small = graph("AveragePool", both, kernel_shape=[shrink] * 2, strides=[shrink] * 2)
    graph.output("feat", small, ("N", 2, "h", "w"))
    return graph.save(path)


def color_features(path: Path) -> Path:
    """Three features of a coloured image: its colours."""
    graph = Graph()
    image = graph.input("image", OPEN)
    graph.output("feat", image, OPEN)
    return graph.save(path)


def brightest_pixels(path: Path, height: int, width: int, count: int = 3, batch: int = 1) -> Path:
    """Keypoints at the pixels with most red, described by how much that is."""
    graph = Graph()
    image = graph.input("image", (batch, 3, height, width))
    flat = graph("Reshape", graph.slice(image, 1, 0, 1), graph.constant([-1], np.int64))
    values, places = graph.largest(flat, count)
    columns = graph.constant([width], np.int64)
    u = graph("Cast", graph("Mod", places, columns), to=FLOAT)
    v = graph("Cast", graph("Div", places, columns), to=FLOAT)
    one = graph.constant([1], np.int64)
    points = graph("Concat", graph("Unsqueeze", u, one), graph("Unsqueeze", v, one), axis=1)
    graph.output("keypoints", points, (count, 2))
    graph.output("descriptors", graph("Unsqueeze", values, one), (count, 1))
    return graph.save(path)


def matcher_of_points(path: Path, count: int = 3, *, beyond: int = 0) -> Path:
    """Each point of the first image with the one whose descriptor is nearest; the score falls with it.

    Args:
        beyond: added to the numbers of the second image's points.
    """
    graph = Graph()
    for name in ("kpts0", "kpts1"):
        graph.input(name, (1, "n", 2))
    first, second = (graph.input(name, (1, "n", 1)) for name in ("desc0", "desc1"))
    apart = graph("Abs", graph("Sub", first, graph("Transpose", second, perm=[0, 2, 1])))
    nearest = graph("ArgMin", apart, axis=2, keepdims=0)  # [1, n]
    nearest = graph("Add", nearest, graph.constant([[beyond]], np.int64))
    own = graph.constant([list(range(count))], np.int64)
    pairs = graph("Transpose", graph("Concat", own, nearest, axis=0), perm=[1, 0])
    graph.output("matches", graph("Cast", pairs, to=FLOAT), ("m", 2), TensorProto.INT64)
    least = graph("ReduceMin", apart, axes=[0, 2], keepdims=0)
    graph.output("scores", graph("Sub", graph.constant(1.0), least), ("m",))
    return graph.save(path)


def flow_of_brightness(
    path: Path, flow: tuple[float, float], shape: Shape = OPEN, *, channels: int = 2
) -> Path:
    """The flow is `flow` times how much brighter the first image is than the second; so it comes back."""
    graph = Graph()
    images = [graph.input(name, shape) for name in ("image1", "image2")]
    first, second = (graph("ReduceMean", image, axes=[1, 2, 3], keepdims=1) for image in images)
    nothing = graph("Mul", graph.slice(images[0], 1, 0, 1), graph.constant(0.0))
    brighter = graph("Add", nothing, graph("Sub", first, second))
    vector = graph.constant(np.resize(np.reshape(flow, (1, 2, 1, 1)), (1, channels, 1, 1)))
    sizes = (shape[0], channels, *shape[2:])
    graph.output("flow_up", graph("Mul", brighter, vector), sizes)
    return graph.save(path)


def constant_flow(path: Path, flow: tuple[float, float], shape: Shape = OPEN) -> Path:
    """One flow everywhere, whichever image comes first."""
    graph = Graph()
    image, _ = graph.input("image1", shape), graph.input("image2", shape)
    nothing = graph("Mul", graph.slice(image, 1, 0, 1), graph.constant(0.0))
    vector = graph.constant(np.reshape(flow, (1, 2, 1, 1)))
    graph.output("flow_up", graph("Add", nothing, vector), (shape[0], 2, *shape[2:]))
    return graph.save(path)


def textured_pair(height: int, width: int, shift: int) -> tuple[Tensor, Tensor]:
    """A rectified pair `[H, W, 3]` in (0, 1] with one disparity: left(u) = right(u - shift)."""
    generator = torch.Generator().manual_seed(5)
    texture = torch.rand(height, width + shift, 3, generator=generator) * 0.9 + 0.1
    return texture[:, :width].contiguous(), texture[:, shift:].contiguous()
