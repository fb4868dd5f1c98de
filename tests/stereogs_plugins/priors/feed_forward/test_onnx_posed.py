"""Networks of cameras and depth, with graphs that answer the true geometry of the procedural room."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from core_rasterizer import Camera
from registry import PluginError, View
from registry.priors import PosedDepth
from registry.testing import check
from registry.toolkit.networks import OnnxModel
from stereogs_plugins.priors.feed_forward.onnx_posed import OnnxPosed, stereogs_register_priors
from tests.stereogs_plugins.building import build, offered
from tests.stereogs_plugins.priors import graphs, rooms

WIDTH, HEIGHT, BORDER = 56, 42, 7
"""Of the networks' images; that of VGGT is square with a border above and below."""


@pytest.fixture(scope="module")
def inside() -> tuple[View, ...]:
    """The room at the networks' size."""
    return rooms.room(WIDTH, HEIGHT)


@pytest.fixture(scope="module")
def photographs() -> tuple[View, ...]:
    """The same at twice that size."""
    return rooms.room(2 * WIDTH, 2 * HEIGHT)


def poses(views: Sequence[View]) -> Tensor:
    return torch.stack([view.camera.world_to_camera[:3] for view in views])


def codes(views: Sequence[View], border: int = BORDER) -> Tensor:
    return torch.stack([rooms.pose_code(view.camera, border) for view in views])


def answered(path: Path, views: Sequence[View], **settings: object) -> list[PosedDepth]:
    prior = build(OnnxPosed, model=path, **settings)
    return prior.posed_depths([view.image for view in views], [None] * len(views))


def is_true(found: Sequence[PosedDepth], views: Sequence[View]) -> bool:
    """Whether cameras, and the depth of nearly all pixels, are those of the views."""
    for answer, view in zip(found, views, strict=True):
        assert view.depth is not None
        camera = view.camera
        right = (answer.depth / 1.0005 / view.depth - 1).abs() < 1e-3
        if not (
            torch.allclose(answer.world_to_camera, camera.world_to_camera.double(), atol=1e-5)
            and torch.allclose(answer.intrinsics, camera.intrinsics.double(), rtol=1e-5)
            and right.float().mean() > 0.6
        ):
            return False
    return True


def test_registers_as_onnx_posed() -> None:
    assert offered(stereogs_register_priors) == {"onnx_posed": OnnxPosed}


@pytest.mark.parametrize("count", [2, 3])
def test_the_geometry_of_vggt_is_true(
    tmp_path: Path, inside: tuple[View, ...], photographs: tuple[View, ...], count: int
) -> None:
    path = rooms.vggt(tmp_path / "m.onnx", inside, codes(inside), BORDER)
    found = answered(path, photographs[:count])
    assert is_true(found, photographs[:count])
    assert torch.allclose(found[0].confidence, torch.tensor(rooms.LOGIT).sigmoid(), atol=1e-5)
    assert build(OnnxPosed, model=path).accepted_views == (2, None)


def inverted(view: View) -> Camera:
    """A camera whose matrix from the world is that to the world."""
    camera = view.camera
    return replace(camera, world_to_camera=camera.camera_to_world)


WRONG: dict[str, Callable[[Tensor], Tensor]] = {
    "quaternion with w first": lambda code: code[:, [0, 1, 2, 6, 3, 4, 5, 7, 8]],
    "horizontal field of view first": lambda code: code[:, [0, 1, 2, 3, 4, 5, 6, 8, 7]],
    "field of view in degrees": lambda code: torch.cat([code[:, :7], code[:, 7:].rad2deg()], 1),
}
"""Conventions of other networks, in place of those of VGGT."""


@pytest.mark.parametrize("convention", [*WRONG, "camera to world"])
def test_another_convention_is_not_true(
    tmp_path: Path, inside: tuple[View, ...], photographs: tuple[View, ...], convention: str
) -> None:
    """Without a border, with which both fields of view would be equal."""
    right = codes(inside, border=0)
    assert is_true(
        answered(rooms.vggt(tmp_path / "t.onnx", inside, right), photographs), photographs
    )
    if convention in WRONG:
        wrong = WRONG[convention](right)
    else:
        wrong = torch.stack([rooms.pose_code(inverted(view)) for view in inside])
    try:
        found = answered(rooms.vggt(tmp_path / "m.onnx", inside, wrong), photographs)
    except PluginError:
        return
    assert not is_true(found, photographs)


@pytest.mark.parametrize(
    "names",
    [
        ("image", "depth", "depth_conf"),
        ("images", "depth", "conf"),
        ("pixel_values", "predicted_depth", "confidence"),
    ],
)
def test_the_geometry_of_depth_anything_3_is_true(
    tmp_path: Path,
    inside: tuple[View, ...],
    photographs: tuple[View, ...],
    names: tuple[str, str, str],
) -> None:
    path = rooms.depth_anything_3(tmp_path / "m.onnx", inside, poses(inside), names=names)
    found = answered(path, photographs, value_range="0..1")
    assert is_true(found, photographs)
    assert torch.allclose(found[0].confidence, torch.tensor(rooms.LOGIT).sigmoid(), atol=1e-5)
    turned = torch.stack([view.camera.world_to_camera.inverse()[:3] for view in inside])
    wrong = rooms.depth_anything_3(tmp_path / "w.onnx", inside, turned, names=names)
    assert not is_true(answered(wrong, photographs, value_range="0..1"), photographs)


def test_photographs_of_other_shapes_get_borders(
    tmp_path: Path, inside: tuple[View, ...], photographs: tuple[View, ...]
) -> None:
    """The middle of a wide photograph is where that of a narrow one is."""
    path = rooms.depth_anything_3(tmp_path / "m.onnx", inside, poses(inside))
    wide, narrow = photographs[0].image[14:70], photographs[1].image[:, 28:84]
    first, second = build(OnnxPosed, model=path).posed_depths([wide, narrow], [None, None])
    assert first.depth.shape == wide.shape[:2]
    assert second.depth.shape == narrow.shape[:2]
    focal = inside[0].camera.fx
    assert torch.allclose(first.intrinsics[0, 0], torch.tensor(2 * focal, dtype=torch.float64))
    assert torch.allclose(second.intrinsics[0, 0], torch.tensor(2 * focal, dtype=torch.float64))
    assert first.intrinsics[:2, 2].tolist() == pytest.approx([WIDTH, 28])
    assert second.intrinsics[:2, 2].tolist() == pytest.approx([28, HEIGHT])


def seen_by(tmp_path: Path, image: Tensor, vggt: bool, **settings: object) -> Tensor:
    """The network's image `[H, W]`, of a graph of any size that returns it as depth."""
    graph = graphs.Graph()
    name, batch = ("input_images", []) if vggt else ("image", [1])
    given = graph.input(name, [*batch, "V", 3, "H", "W"])
    red = graph.slice(given, 1 if vggt else 2, 0, 1)
    graph.output("depth", red, [*batch, "V", 1, "H", "W"])
    pose = graph.constant([[0, 0, 0, 0, 0, 0, 1, 1, 1]] * 2)
    if vggt:
        graph.output("pose_enc", pose, (2, 9))
    for name, rows in ({} if vggt else {"extrinsics": 4, "intrinsics": 3}).items():
        graph.output(name, graph.constant([[torch.eye(rows).tolist()] * 2]), (1, 2, rows, rows))
    prior = build(OnnxPosed, model=graph.save(tmp_path / "m.onnx"), **settings)
    given_to: list[Tensor] = []
    run = OnnxModel.run

    def watched(self: OnnxModel, inputs: dict[str, Tensor]) -> dict[str, Tensor]:
        given_to.extend(inputs.values())
        return run(self, inputs)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(OnnxModel, "run", watched)
        prior.estimate([image, image], [None, None])
    return given_to[0].reshape(2, 3, *given_to[0].shape[-2:])[0, 0]


def test_sizes_are_multiples_of_14_and_value_ranges_those_of_the_network(tmp_path: Path) -> None:
    grey = torch.full((300, 400, 3), 0.8)
    for settings, size in ({}, (378, 504)), ({"long_side": 252}, (196, 252)):
        seen = seen_by(tmp_path, grey, False, **settings)
        assert seen.shape == size
        assert torch.allclose(seen, torch.tensor((0.8 - 0.485) / 0.229), atol=1e-4)
    seen = seen_by(tmp_path, grey, True)
    assert seen.shape == (392, 518)  # 388.5 rows
    assert torch.allclose(seen[2:-2], torch.tensor(0.8), atol=1e-4)
    assert seen[0].unique().tolist() == seen[-1].unique().tolist() == [1.0]
    assert torch.allclose(
        seen_by(tmp_path, grey, False, value_range="0..1"), torch.tensor(0.8), atol=1e-4
    )


def test_it_keeps_the_contract(tmp_path: Path, inside: tuple[View, ...]) -> None:
    check(OnnxPosed, model=rooms.vggt(tmp_path / "m.onnx", inside, codes(inside), BORDER))


def test_the_number_of_views_is_that_of_the_graph(
    tmp_path: Path, inside: tuple[View, ...], photographs: tuple[View, ...]
) -> None:
    path = rooms.depth_anything_3(tmp_path / "m.onnx", inside, poses(inside), count=3)
    assert build(OnnxPosed, model=path).accepted_views == (3, 3)
    with pytest.raises(PluginError, match="accepts 3 to 3 photographs, and got 2"):
        answered(path, photographs[:2])
    few = rooms.depth_anything_3(tmp_path / "f.onnx", inside[:2], poses(inside[:2]))
    with pytest.raises(PluginError, match=r"'depth' has the shape \[1, 2, 42, 56\] for 3 images"):
        answered(few, photographs)


def test_other_graphs_are_refused_and_not_recognized(
    tmp_path: Path, inside: tuple[View, ...]
) -> None:
    one = rooms.depth_anything_3(tmp_path / "one.onnx", inside, poses(inside), count=1)
    for path in (
        one,
        graphs.mono(tmp_path / "mono.onnx"),
        graphs.pick(tmp_path / "p.onnx", "K", (0, 0, 0)),
    ):
        assert OnnxPosed.settings_for(OnnxModel(path)) == []
        with pytest.raises(PluginError, match="neither that of Depth Anything 3"):
            build(OnnxPosed, model=path)
    many = OnnxModel(rooms.depth_anything_3(tmp_path / "m.onnx", inside, poses(inside)))
    assert [found.get("value_range") for found in OnnxPosed.settings_for(many)] == [None, "0..1"]
