from __future__ import annotations

import numpy as np
import pydantic
import pytest
import torch
from torch import Tensor
from torch.nn.functional import grid_sample

from core_rasterizer import Camera
from registry import Scene, View
from stereogs_plugins.scenes.procedural import ProceduralScene, stereogs_register_scenes
from stereogs_plugins.scenes.procedural.ray_casting import Rectangle, Sphere, Texture, cast
from tests.stereogs_plugins.building import build, offered

WHITE = Texture(np.ones((2, 2, 3)))
CAMERA = Camera(torch.eye(4), 20, 20, 10.5, 8.5, 21, 17)


SMALL = {"width": 84, "height": 63}
"""A third of the default size."""


@pytest.fixture
def scene(procedural_room: Scene) -> Scene:
    return procedural_room


@pytest.fixture(scope="module")
def small() -> Scene:
    return build(ProceduralScene, **SMALL).load()


def test_registers_as_procedural() -> None:
    assert offered(stereogs_register_scenes) == {"procedural": ProceduralScene}


def unproject(view: View) -> Tensor:
    """`[H, W, 3]` world points behind the pixel centres."""
    assert view.depth is not None
    return view.camera.unproject(*view.camera.pixel_centers(), view.depth)


def warp(source: View, target: View) -> tuple[Tensor, Tensor]:
    """The source's colours at the target's pixels `[H, W, 3]`, and where they are to be trusted."""
    assert source.depth is not None
    u, v, z = source.camera.project(unproject(target))
    x, y = u / source.camera.width * 2 - 1, v / source.camera.height * 2 - 1
    grid = torch.stack([x, y], dim=-1).float()[None]
    colors = grid_sample(source.image.permute(2, 0, 1)[None], grid, align_corners=False)
    depth = grid_sample(source.depth[None, None], grid, mode="nearest", align_corners=False)[0, 0]
    inside = (x.abs() < 1) & (y.abs() < 1)
    return colors[0].permute(1, 2, 0), inside & ((depth / z - 1).abs() < 0.01)


def score(first: Tensor, second: Tensor, mask: Tensor) -> float:
    return float(-10 * torch.log10(((first - second)[mask] ** 2).mean()))


def test_a_view_warped_through_the_depth_is_the_other_view(scene: Scene) -> None:
    for source in scene.train:
        for target in (*scene.train, *scene.test):
            colors, visible = warp(source, target)
            assert visible.float().mean() > 0.5
            assert score(colors, target.image, visible) > 29
            if target is not source:
                assert score(source.image, target.image, visible) < 20  # not warped


def test_every_pixel_has_a_depth_within_the_bounds(scene: Scene) -> None:
    near, far = scene.bounds
    for view in scene.train:
        assert view.depth is not None
        assert view.depth.min() > near
        assert view.depth.max() < far


def test_points_lie_on_surfaces_with_the_right_colors() -> None:
    scene = build(ProceduralScene, point_noise=0.0, points=301, test_views=0, **SMALL).load()
    assert scene.points is not None
    assert len(scene.points) == 301
    surface = torch.cat([unproject(view).reshape(-1, 3) for view in scene.train])
    colors = torch.cat([view.image.reshape(-1, 3) for view in scene.train])
    distance, nearest = torch.cdist(scene.points.positions.double(), surface).min(dim=1)
    assert distance.max() < 1e-5
    torch.testing.assert_close(colors[nearest], scene.points.colors)


def test_noise_has_the_given_size() -> None:
    exact, noisy = (
        build(ProceduralScene, point_noise=noise, test_views=0, **SMALL).load()
        for noise in (0.0, 0.05)
    )
    assert exact.points is not None
    assert noisy.points is not None
    moved = noisy.points.positions - exact.points.positions
    assert moved.std() == pytest.approx(0.05, rel=0.05)
    torch.testing.assert_close(noisy.points.colors, exact.points.colors)


def test_the_same_settings_give_the_same_bits(small: Scene) -> None:
    again = build(ProceduralScene, 77, **SMALL).load()  # the run's seed does not matter
    for first, second in zip(small.train + small.test, again.train + again.test, strict=True):
        assert torch.equal(first.image, second.image)
        assert first.depth is not None
        assert second.depth is not None
        assert torch.equal(first.depth, second.depth)
    assert small.points is not None
    assert again.points is not None
    assert torch.equal(small.points.positions, again.points.positions)


def test_another_seed_moves_the_furniture(small: Scene) -> None:
    other = build(ProceduralScene, **{**SMALL, "seed": 1}).load()
    assert not torch.equal(small.train[0].image, other.train[0].image)
    assert (small.train[0].camera.world_to_camera == other.train[0].camera.world_to_camera).all()


def test_counts_and_sizes() -> None:
    scene = build(
        ProceduralScene, train_views=1, test_views=2, width=40, height=30, points=0
    ).load()
    assert (len(scene.train), len(scene.test)) == (1, 2)
    assert scene.train[0].image.shape == (30, 40, 3)
    assert scene.points is None


def test_a_wall_in_front_has_its_own_depth_and_an_upright_picture() -> None:
    corners = np.array([[[1.0, 0, 0], [0, 1.0, 0]], [[0, 0, 1.0], [1.0, 1.0, 1.0]]])
    wall = Rectangle(
        np.array([-0.5, -0.4, 2.0]), np.array([1.0, 0, 0]), np.array([0, 0.8, 0]), Texture(corners)
    )
    colors, depth = cast([wall], CAMERA)
    assert depth[8, 10] == 2
    assert depth[0, 0] == 0
    tints = {
        (5, 6): 0,
        (5, 14): 1,
        (11, 6): 2,
    }  # red upper left, green upper right, blue lower left
    for (row, column), channel in tints.items():
        assert colors[row, column].argmax() == channel


def test_a_ball_is_one_radius_nearer_than_its_center_and_hides_what_is_behind() -> None:
    ball = Sphere(np.array([0.0, 0.0, 3.0]), 0.5, WHITE)
    wall = Rectangle(
        np.array([-9.0, -9.0, 4.0]), np.array([18.0, 0, 0]), np.array([0, 18.0, 0]), WHITE
    )
    orders: list[list[Rectangle | Sphere]] = [[ball, wall], [wall, ball]]
    for surfaces in orders:
        _, depth = cast(surfaces, CAMERA)
        assert depth[8, 10] == pytest.approx(2.5)
        assert depth[0, 0] == pytest.approx(4.0)
        assert ((depth > 3) == (depth > 3.99)).all()


def test_a_wall_is_transparent_from_behind() -> None:
    away = Rectangle(
        np.array([1.0, -1.0, 2.0]), np.array([-2.0, 0, 0]), np.array([0, 2.0, 0]), WHITE
    )
    assert cast([away], CAMERA)[1].max() == 0


@pytest.mark.parametrize("name", ["train_views", "test_views", "points", "width", "height"])
def test_settings_that_need_too_much_memory_are_errors(name: str) -> None:
    with pytest.raises(pydantic.ValidationError, match="less than or equal to"):
        build(ProceduralScene, **{name: 100_000_000})
