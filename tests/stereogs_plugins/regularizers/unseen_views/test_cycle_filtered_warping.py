from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from core_rasterizer import Camera, Rendering
from registry import Scene, Step, View
from stereogs_plugins.regularizers.unseen_views import CycleFilteredWarping
from tests.stereogs_plugins.building import build, some_gaussians, step_with
from tests.stereogs_plugins.initializers.depth_scenes import camera_at

WALL = 5.0


def texture(camera: Camera) -> torch.Tensor:
    """What a camera sees of a coloured wall at z = 5, `[H, W, 3]`."""
    u, v = camera.pixel_centers()
    x, y, _ = camera.unproject(u, v, torch.full_like(u, WALL)).unbind(-1)
    waves = [torch.sin(1.1 * x), torch.cos(0.9 * y), torch.sin(0.7 * (x + y))]
    return (0.5 + 0.4 * torch.stack(waves, dim=2)).float()


def step_before_wall(depth_of_virtual: float, gain: float = 1.0, apart: float = 1.0) -> Step:
    """Photographs of the wall; renders that show it, but a virtual camera's at another depth."""
    step = step_with(some_gaussians([0.1], [0.5]))
    cameras = [camera_at(x) for x in (-apart, 0.0, apart)]
    views = tuple(View(f"{k}", c, texture(c)) for k, c in enumerate(cameras))
    step = replace(step, scene=Scene("wall", views, (), (1.0, 10.0)).for_training())
    known = {float(c.center[0]) for c in cameras}

    def render(camera: Camera, *, gradient: bool = True, **_: object) -> Rendering:
        real = not gradient and float(camera.center[0]) in known
        depth = torch.full((40, 60), WALL if real else depth_of_virtual)
        alpha = torch.full((40, 60), 0.8)
        rgb = (gain * texture(camera)).requires_grad_(gradient)
        return Rendering(rgb, (depth * alpha).requires_grad_(gradient), alpha)

    return replace(step, render=render)


def test_a_right_depth_finds_the_colours_and_a_wrong_picture_its_error() -> None:
    # The virtual camera's own wall is seen at z = 5 minus its step forwards: radius 0 makes it exact.
    term = build(CycleFilteredWarping, radius=1e-9)
    logged: dict[str, float] = {}
    step = replace(step_before_wall(WALL), log=logged.__setitem__)
    assert float(term.loss(step).detach()) < 2e-3
    assert logged["under test_counted"] > 0.8
    darker = term.loss(step_before_wall(WALL, gain=0.5))
    assert float(darker.detach()) == pytest.approx(0.5 * 0.5, rel=0.15)


def test_depths_that_do_not_come_full_circle_count_nowhere() -> None:
    # The virtual render says 4 where the photographs' cameras say 5: 25 % off, 1 % is allowed.
    wrong = step_before_wall(4.0)
    assert float(build(CycleFilteredWarping, radius=1e-9).loss(wrong)) == 0
    loose = build(CycleFilteredWarping, radius=1e-9, max_depth_error=0.3).loss(wrong)
    assert float(loose.detach()) > 0.01


def test_as_many_photographs_as_asked_must_agree() -> None:
    """Cameras 4 apart see the wall 40 of 60 pixels apart: a third of it in common with a neighbour."""
    shares = []
    for agreeing in (0.3, 0.6, 1.0):
        logged: dict[str, float] = {}
        step = replace(step_before_wall(WALL, apart=4.0), log=logged.__setitem__)
        build(CycleFilteredWarping, radius=1e-9, agreeing=agreeing).loss(step)
        shares.append(logged["under test_counted"])
    assert shares[0] == 1.0  # its own photograph is enough
    assert shares[1] == pytest.approx(1 / 3, abs=0.02) or shares[1] == pytest.approx(
        2 / 3, abs=0.02
    )
    assert shares[2] == 0.0


def test_the_virtual_camera_stands_on_the_sphere_and_looks_the_same_way() -> None:
    step = step_before_wall(WALL)
    term = build(CycleFilteredWarping, radius=0.3)
    centers = [view.camera.center for view in step.scene.train]
    for _ in range(10):
        camera = term._camera(step)
        distances = torch.stack([(camera.center - center).norm() for center in centers])
        assert float((distances - 0.3 * step.extent).abs().min()) < 1e-9
        assert torch.equal(camera.world_to_camera[:3, :3], torch.eye(3, dtype=torch.float64))


def test_gradients_reach_colours_and_depth() -> None:
    step = step_before_wall(WALL + 0.02, gain=0.9)
    made = []
    inner = step.render

    def render(camera: Camera, *, gradient: bool = True, **_: object) -> Rendering:
        made.append(inner(camera, gradient=gradient))
        return made[-1]

    step = replace(step, render=render)
    build(CycleFilteredWarping, radius=1e-9).loss(step).backward()
    assert made[0].rgb.grad is not None
    assert made[0].depth.grad is not None
    assert made[0].rgb.grad.abs().sum() > 0
    assert made[0].depth.grad.abs().sum() > 0
