from __future__ import annotations

import math

import pytest
import torch

from core_rasterizer import Camera
from registry import PluginError
from registry.testing import tiny_scene
from registry.toolkit.views import virtual_views

BOUNDS = (2.0, 20.0)


def camera(*place: float, at: tuple[float, float, float] = (0, 0, 0)) -> Camera:
    return Camera.look_at(place, at, 50, 40, 30)


RING = [camera(4 * math.sin(a), -1, -4 * math.cos(a)) for a in (-0.3, 0.1, 0.4)]


def drawn(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def test_the_focus_depth_is_the_published_one() -> None:
    # Bounds that FSGS's code quotes, of LLFF; 0.25 / 14.58 + 0.75 / 769.5 = 0.0181215.
    assert 1 / virtual_views.focus_depth((16.2, 153.9)) == pytest.approx(0.0181215, rel=1e-5)


def test_the_focus_is_where_the_axes_meet() -> None:
    torch.testing.assert_close(
        virtual_views.focus_point(RING, BOUNDS), torch.zeros(3, dtype=torch.float64)
    )


def test_parallel_and_diverging_axes_focus_ahead() -> None:
    parallel = [camera(x, 0, 0, at=(x, 0, 1)) for x in (-1, 1)]
    parting = [camera(x, 0, 0, at=(3 * x, 0, 1)) for x in (-1, 1)]
    ahead = torch.tensor([0, 0, virtual_views.focus_depth(BOUNDS)], dtype=torch.float64)
    for cameras in (parallel, parting):
        torch.testing.assert_close(virtual_views.focus_point(cameras, BOUNDS), ahead)


def test_between_is_one_at_each_end_and_half_turned_in_the_middle() -> None:
    first, second = camera(0, 0, 0, at=(0, 0, 1)), camera(2, 0, 0, at=(3, 0, 1))
    for share, end in ((0.0, first), (1.0, second)):
        there = virtual_views.between(first, second, share)
        torch.testing.assert_close(there.world_to_camera, end.world_to_camera)
    middle = virtual_views.between(first, second, 0.5)
    torch.testing.assert_close(middle.center, torch.tensor([1, 0, 0], dtype=torch.float64))
    angle = math.atan2(middle.camera_to_world[0, 2], middle.camera_to_world[2, 2])
    assert angle == pytest.approx(math.pi / 8)


def test_a_camera_in_the_box_stays_in_it_and_sees_the_focus() -> None:
    cameras = [camera(x, y, 0, at=(x, y, 1)) for x, y in ((-1, 0.5), (0, -0.5), (1, 0))]
    focus = torch.tensor([0, 0, virtual_views.focus_depth(BOUNDS)], dtype=torch.float64)
    generator, reached = drawn(), torch.zeros(3, dtype=torch.float64)
    for _ in range(50):
        one = virtual_views.in_box(cameras, BOUNDS, generator)
        u, v, _ = one.project(focus)
        assert (float(u), float(v)) == pytest.approx((20, 15))
        assert one.camera_to_world[:3, 1] @ cameras[0].camera_to_world[:3, 1] > 0.9, "upright"
        reached = torch.maximum(reached, one.center.abs())
    assert (reached <= torch.tensor([1, 0.5, 1e-9])).all()
    assert (reached[:2] > torch.tensor([0.8, 0.4])).all()


def test_a_camera_on_the_sphere_keeps_its_distance_and_the_cap() -> None:
    generator = drawn()
    centers = torch.stack([c.center for c in RING])
    directions = centers / centers.norm(dim=1, keepdim=True)
    pole = directions.sum(0) / directions.sum(0).norm()
    for _ in range(50):
        one = virtual_views.on_sphere(RING, BOUNDS, generator)
        assert float(one.center.norm()) == pytest.approx(math.sqrt(17))
        assert float(one.center @ pole) / math.sqrt(17) >= float((directions @ pole).min()) - 1e-9
        u, v, z = one.project(torch.zeros(3))
        assert (float(u), float(v)) == pytest.approx((20, 15), abs=1e-6)
        assert z > 0


def test_between_neighbours_stays_near_their_line() -> None:
    cameras = [camera(x, 0, 0, at=(x, 0, 1)) for x in (0, 1, 10)]
    generator = drawn()
    for _ in range(30):
        x, y, z = virtual_views.between_neighbours(cameras, generator).center.tolist()
        assert -0.5 < x < 1.5 or 1 - 3 < x < 10 + 3
        assert abs(y) < 3.6
        assert abs(z) < 3.6


def test_one_seed_gives_the_same_cameras_and_every_kind_is_drawn() -> None:
    scene = tiny_scene().for_training()
    for kind in ("box", "between", "sphere"):
        first, again, other = (
            virtual_views.draw(kind, scene, drawn(seed)).world_to_camera for seed in (1, 1, 2)
        )
        assert torch.equal(first, again)
        assert not torch.equal(first, other)


def test_one_training_camera_is_enough() -> None:
    for kind in (virtual_views.in_box, virtual_views.on_sphere):
        one = kind(RING[:1], BOUNDS, drawn())
        torch.testing.assert_close(one.center, RING[0].center)
    alone = virtual_views.between_neighbours(RING[:1], drawn())
    torch.testing.assert_close(alone.center, RING[0].center)


def test_cameras_that_face_each_other_have_no_box() -> None:
    with pytest.raises(PluginError, match="face each other"):
        virtual_views.in_box([camera(0, 0, -1), camera(0, 0, 1)], BOUNDS, drawn())
