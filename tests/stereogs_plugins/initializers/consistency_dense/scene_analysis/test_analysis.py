"""Kinds of scene, and points that silhouettes refute."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from core_rasterizer import Camera
from registry import View
from stereogs_plugins.initializers.consistency_dense.scene_analysis.analysis import (
    SceneAnalysis,
    safely_inside,
    scene_kind,
)
from stereogs_plugins.initializers.consistency_dense.scene_analysis.plain_background import (
    PlainAreas,
)

RADIUS = 0.5
NOTHING = np.zeros((48, 64), dtype=np.bool_)


def around(degrees: float) -> Camera:
    """A camera that looks at the origin from a distance of 4."""
    angle = math.radians(degrees)
    eye = (4 * math.sin(angle), 0.0, -4 * math.cos(angle))
    return Camera.look_at(eye, (0.0, 0.0, 0.0), 80, 64, 48)


def ball(degrees: float) -> View:
    """A textured ball about the origin before black."""
    camera = around(degrees)
    u, v = camera.pixel_centers()
    inside = torch.hypot(u - 32, v - 24) < 80 * RADIUS / 4
    texture = torch.rand(48, 64, 3, generator=torch.Generator().manual_seed(int(degrees)))
    return View(f"at{degrees}", camera, torch.where(inside[..., None], texture, 0.0))


@pytest.fixture(scope="module")
def balls() -> SceneAnalysis:
    views = [ball(degrees) for degrees in (0, 60, 120)]
    return SceneAnalysis.without_depths(views, PlainAreas.of(views))


def test_kind_depends_on_background_and_viewing_directions() -> None:
    half = np.ones_like(NOTHING)
    half[:24] = False
    near, wide = [around(0), around(20)], [around(0), around(90)]
    assert scene_kind(near, [NOTHING, NOTHING]) == "forward-facing"
    assert scene_kind(wide, [NOTHING, NOTHING]) == "surrounding"
    assert scene_kind(near, [half, half]) == scene_kind(wide, [half, half]) == "object"


def test_facts_and_summary(balls: SceneAnalysis) -> None:
    share = 1 - math.pi * (80 * RADIUS / 4) ** 2 / (48 * 64)
    assert balls.facts()["scene_kind"] == "object"
    assert balls.facts()["plain_background"] == pytest.approx(share, abs=0.06)
    assert "object" in balls.summary
    assert "% of the pixels" in balls.summary


def test_silhouettes_refute_points_next_to_the_object(balls: SceneAnalysis) -> None:
    generator = np.random.default_rng(0)
    directions = generator.normal(size=(500, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    on_ball, behind = RADIUS * directions, np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    for guessed in (False, True):
        assert not balls.refutes(on_ball, guessed=guessed).any()
        # The first camera looks along this line through the ball; the other two look past it.
        assert balls.refutes(behind, guessed=guessed).all()


def test_one_view_refutes_a_guess_and_two_a_confirmed_point(balls: SceneAnalysis) -> None:
    only_first = replace(balls, safe=(balls.safe[0], NOTHING, NOTHING))
    beside, outside_all_images = np.array([[0.8, 0.0, 0.0]]), np.array([[0.0, 2.2, 0.0]])
    assert only_first.refutes(beside, guessed=True).all()
    assert not only_first.refutes(beside, guessed=False).any()
    assert not balls.refutes(outside_all_images, guessed=True).any()


def test_depths_on_plain_background_are_removed(balls: SceneAnalysis) -> None:
    depths = balls.without_background([np.full((48, 64), 3.0, dtype=np.float32)] * 3)
    for depth, safe in zip(depths, balls.safe, strict=True):
        assert np.array_equal(depth > 0, ~safe)
        assert (depth[18:30, 26:38] == 3).all()


def test_a_strip_along_silhouettes_and_borders_is_ignored() -> None:
    background = np.ones((200, 300), dtype=np.bool_)
    background[:, 150:] = False
    safe = safely_inside(background)
    assert safe[100, 140]
    assert not safe[100, 147:].any()
    assert not safe[:3].any()
    assert not safely_inside(np.zeros((4, 4), dtype=np.bool_)).any()
