"""The procedural room as networks of cameras and depth would describe it: graphs that answer the truth."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from core_rasterizer import Camera
from registry import View
from stereogs_plugins.scenes.procedural import ProceduralScene
from tests.stereogs_plugins.building import build
from tests.stereogs_plugins.priors.graphs import FLOAT, Graph, Shape

LOGIT = 1.2
"""Of the confidence of known depth."""


def room(width: int, height: int, **settings: object) -> tuple[View, ...]:
    """Three views of the room; by default the cameras look inwards from an arc."""
    size = {"width": width, "height": height, "test_views": 0, "points": 0}
    return build(ProceduralScene, 0, **size, **settings).load().train


def depths(views: Sequence[View], border: int = 0) -> Tensor:
    """`[V, H, W]`, 99 above and below the picture."""
    known = torch.stack([view.depth for view in views if view.depth is not None])
    return torch.nn.functional.pad(known, (0, 0, border, border), value=99.0)


def pose_code(camera: Camera, border: int = 0) -> Tensor:
    """Nine numbers of VGGT: translation, quaternion (x, y, z, w), vertical and horizontal field of view."""
    pose = camera.world_to_camera.double()
    turn = torch.from_numpy(Rotation.from_matrix(pose[:3, :3].numpy()).as_quat())
    vertical = 2 * np.arctan((camera.height / 2 + border) / camera.fy)
    horizontal = 2 * np.arctan(camera.width / 2 / camera.fx)
    return torch.cat([pose[:3, 3], turn, torch.tensor([vertical, horizontal])])


def vggt(path: Path, views: Sequence[View], codes: Tensor, border: int = 0) -> Path:
    """`input_images` `[V, 3, H, W]`, V open; the number of views decides how many cameras are answered."""
    height, width = views[0].image.shape[0] + 2 * border, views[0].image.shape[1]
    answers = {"pose_enc": codes[None], "depth": depths(views, border)[None, ..., None]}
    return _answering(
        path, "input_images", ("num_images", 3, height, width), 0, answers, "depth_conf"
    )


def depth_anything_3(
    path: Path,
    views: Sequence[View],
    poses: Tensor,
    *,
    names: tuple[str, str, str] = ("image", "depth", "depth_conf"),
    count: int | str = "N",
    pinned: int = 0,
) -> Path:
    """`image` `[1, N, 3, H, W]`.

    Args:
        pinned: number of views with which depth is right; with others it is wrong.
    """
    height, width = views[0].image.shape[:2]
    lenses = torch.stack([view.camera.intrinsics for view in views])
    answers = {names[1]: depths(views)[None], "extrinsics": poses[None], "intrinsics": lenses[None]}
    return _answering(
        path, names[0], (1, count, 3, height, width), 1, answers, names[2], pinned=pinned
    )


def _answering(
    path: Path,
    images: str,
    shape: Shape,
    axis: int,
    answers: dict[str, Tensor],
    confidence: str,
    pinned: int = 0,
) -> Path:
    """A graph that answers the first numbers of each constant, one for each image.

    Depth grows by a thousandth of the images' mean, so that it depends on all of them.
    """
    graph = Graph()
    given = graph.input(images, shape)
    one = graph.constant([1], np.int64)
    count = graph("Gather", graph("Shape", given), graph.constant([axis], np.int64))
    start = graph.constant([0], np.int64)
    factor = graph("Mul", graph("ReduceMean", given, keepdims=0), graph.constant(1e-3))
    factor = graph("Add", factor, graph.constant(1.0))
    for name, numbers in answers.items():
        whole = graph.constant(numbers.numpy())
        value = graph("Slice", whole, start, count, one)
        if "depth" in name:
            value = graph("Mul", value, factor)
            if pinned:
                value = _bent(graph, value, count, pinned)
            trust = graph("Add", graph("Mul", value, graph.constant(0.0)), graph.constant(LOGIT))
            trust = graph("Add", graph("Exp", trust), graph.constant(1.0))
            if numbers.ndim == 5:
                trust = graph("Squeeze", trust, graph.constant([4], np.int64))
            graph.output(confidence, trust, [1, "n", *numbers.shape[2:4]])
        graph.output(name, value, [1, "n", *numbers.shape[2:]])
    return graph.save(path)


def _bent(graph: Graph, depth: str, count: str, pinned: int) -> str:
    """Depth `[1, V, H, W]`, up to three times as large to the right unless there are `pinned` views."""
    same = graph("Equal", graph("Cast", count, to=FLOAT), graph.constant([float(pinned)]))
    width = graph("Gather", graph("Shape", depth), graph.constant([3], np.int64))
    ones = graph("Expand", graph.constant([1.0]), width)
    growth = graph(
        "CumSum", graph("Div", ones, graph("Cast", width, to=FLOAT)), graph.constant(0, np.int64)
    )
    bend = graph("Add", graph("Add", growth, growth), graph.constant([1.0]))
    return graph("Mul", depth, graph("Where", same, ones, bend))
