"""SHARP, with a graph that answers the true surface of the procedural room."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from registry import PluginError, View
from registry.testing import check
from registry.toolkit.networks import OnnxModel
from stereogs_plugins.priors.feed_forward.onnx_gaussians import (
    OnnxGaussians,
    stereogs_register_priors,
)
from tests.stereogs_plugins.building import build, offered
from tests.stereogs_plugins.priors import graphs, rooms

UNIT = 5.0
"""World units of the network's unit."""
SCALES = torch.tensor([0.01, 0.02, 0.03], dtype=torch.float64)
TURN = torch.from_numpy(Rotation.from_rotvec([0.5, 0.2, -0.7]).as_matrix())
"""Of the Gaussians' axes to those of the camera."""


@pytest.fixture(scope="module")
def room() -> tuple[View, ...]:
    return rooms.room(96, 72)


def truth(view: View) -> Tensor:
    """Points `[P, 3]` of the view's pixels, in the world."""
    assert view.depth is not None
    u, v = view.camera.pixel_centers()
    return view.camera.unproject(u.ravel(), v.ravel(), view.depth.double().ravel())


def sharp(path: Path, view: View, **changed: Tensor) -> Path:
    """A graph that answers a Gaussian for each pixel of the view, in the network's coordinates and unit."""
    camera = view.camera
    pose = camera.world_to_camera.double()
    points = (truth(view) @ pose[:3, :3].T + pose[:3, 3]) / UNIT
    device = torch.tensor([2 * camera.fx / camera.width, 2 * camera.fy / camera.height, 1]).double()
    axes = device[:, None] * TURN * SCALES / UNIT
    variances, turn = torch.linalg.eigh(axes @ axes.T)  # axes of the device have other lengths
    turn[:, 0] *= torch.linalg.det(turn)
    x, y, z, w = Rotation.from_matrix(turn.numpy()).as_quat()
    means = points * device
    count = len(means)
    answers = {
        "mean_vectors": means,
        "singular_values": variances.sqrt().expand(count, 3),
        "quaternions": 2 * torch.tensor([w, x, y, z]).expand(count, 4),
        "colors": torch.full((count, 3), 0.2140),
        "opacities": torch.full((count, 1), 1.0),
        **changed,
    }
    graph = graphs.Graph()
    image = graph.input("image", (1, 3, 64, 64))
    factor = graph.input("disparity_factor", (1,))
    zero = graph("Mul", graph("ReduceMean", image, keepdims=0), graph.constant(0.0))
    zero = graph("Mul", graph("Add", factor, zero), graph.constant(0.0))
    for name, numbers in answers.items():
        given = numbers[:, 0] if name == "opacities" else numbers
        value = graph("Add", graph.constant(given[None].float().numpy()), zero)
        graph.output(name, value, (1, *given.shape))
    return graph.save(path)


def test_registers_as_onnx_gaussians() -> None:
    assert offered(stereogs_register_priors) == {"onnx_gaussians": OnnxGaussians}


def test_the_gaussians_are_where_the_room_is(tmp_path: Path, room: tuple[View, ...]) -> None:
    path = sharp(tmp_path / "m.onnx", room[0])
    (settings,) = OnnxGaussians.settings_for(OnnxModel(path))
    found = build(OnnxGaussians, views=1, **settings).gaussians(room, (1.0, 10.0))
    true = truth(room[0])
    distances = (true - room[0].camera.center).norm(dim=1)
    assert ((found.positions - true).norm(dim=1) / distances).max() < 0.01
    assert found.scales is not None
    assert found.opacities is not None
    assert found.quaternions is not None
    assert torch.allclose(found.scales, SCALES.float().expand(len(true), 3), rtol=0.01)
    assert torch.allclose(found.colors, torch.tensor(0.5), atol=1e-3)  # sRGB
    assert torch.allclose(found.opacities, torch.tensor(1.0), atol=1e-5)


def test_shapes_turn_with_the_camera(tmp_path: Path, room: tuple[View, ...]) -> None:
    """The covariance is that of the world."""
    path = sharp(tmp_path / "m.onnx", room[0])
    found = build(OnnxGaussians, model=path, views=1).gaussians(room, (1.0, 10.0))
    assert found.quaternions is not None
    assert found.scales is not None
    w, x, y, z = found.quaternions[0].tolist()
    axes = torch.from_numpy(Rotation.from_quat([x, y, z, w]).as_matrix()) * found.scales[0]
    wanted = room[0].camera.camera_to_world[:3, :3].double() @ TURN * SCALES
    assert torch.allclose(axes @ axes.T, wanted @ wanted.T, atol=1e-5)


def test_a_single_photograph_has_a_unit_by_the_bounds(
    tmp_path: Path, room: tuple[View, ...]
) -> None:
    path = sharp(tmp_path / "m.onnx", room[0])
    found = build(OnnxGaussians, model=path).gaussians(room[:1], (2.0, 8.0))
    depths = found.positions @ room[0].camera.world_to_camera[2, :3].float()
    depths += room[0].camera.world_to_camera[2, 3]
    assert float(depths.median()) == pytest.approx(4.0, rel=1e-3)


def test_each_photograph_gives_gaussians(tmp_path: Path, room: tuple[View, ...]) -> None:
    path = sharp(tmp_path / "m.onnx", room[0])
    assert len(build(OnnxGaussians, model=path).gaussians(room, (1.0, 10.0))) == 3 * 96 * 72


def test_what_is_not_sharp_is_refused(tmp_path: Path, room: tuple[View, ...]) -> None:
    other = graphs.mono(tmp_path / "mono.onnx")
    assert OnnxGaussians.settings_for(OnnxModel(other)) == []
    with pytest.raises(PluginError, match="no input 'disparity_factor'"):
        build(OnnxGaussians, model=other)
    few = sharp(tmp_path / "few.onnx", room[0], colors=torch.ones(7, 3))
    with pytest.raises(PluginError, match=r"'colors' has the shape \[1, 7, 3\]"):
        build(OnnxGaussians, model=few).gaussians(room, (1.0, 10.0))
    behind = sharp(tmp_path / "behind.onnx", room[0], mean_vectors=-torch.ones(96 * 72, 3))
    with pytest.raises(PluginError, match="no Gaussian in front of the camera"):
        build(OnnxGaussians, model=behind).gaussians(room, (1.0, 10.0))


def test_it_keeps_the_contract(tmp_path: Path, room: tuple[View, ...]) -> None:
    check(OnnxGaussians, model=sharp(tmp_path / "m.onnx", room[0]))
