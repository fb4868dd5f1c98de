from __future__ import annotations

import math
from itertools import combinations

import pytest
import torch

from core_rasterizer import Camera
from registry.toolkit.views.triangulation import MAX_PARTNERS, pairs_to_match, triangulate
from stereogs_plugins.scenes.llff import LLFFScene
from stereogs_plugins.scenes.procedural import ProceduralScene
from tests.data import data_folder
from tests.stereogs_plugins.building import build


def ring(count: int) -> list[Camera]:
    """Return cameras around the origin that look at it."""
    angles = [2 * math.pi * k / count for k in range(count)]
    eyes = [(4 * math.sin(angle), 0.0, 4 * math.cos(angle)) for angle in angles]
    return [Camera.look_at(eye, (0.0, 0.0, 0.0), 80, 64, 48) for eye in eyes]


def test_error_and_angle_are_limits() -> None:
    scene = build(ProceduralScene, width=168, height=126).load()
    views, bounds = scene.train, scene.bounds
    loose, strict = (
        triangulate(views, bounds, max_reprojection_error=error, min_angle=1.5, seed=0)
        for error in (4.0, 0.5)
    )
    assert strict.errors.max() <= 0.5 < loose.errors.max()
    assert (loose.seen_by.sum(dim=1) >= 2).all()
    wide = triangulate(views, bounds, max_reprojection_error=4.0, min_angle=12.0, seed=0)
    assert 0 < len(wide.positions) < len(loose.positions)


def test_up_to_nine_photographs_are_all_matched_beyond_that_the_near_ones() -> None:
    few, many = ring(9), ring(24)
    assert pairs_to_match(few, (2.0, 6.0)) == list(combinations(range(9), 2))
    pairs = pairs_to_match(many, (2.0, 6.0))
    assert pairs == sorted(set(pairs))
    assert len(pairs) <= 24 * MAX_PARTNERS
    between = {min(second - first, 24 - second + first) for first, second in pairs}
    assert between == set(range(1, max(between) + 1))
    assert max(between) < 6  # 90 degrees


@pytest.mark.proof
@pytest.mark.parametrize(("name", "least"), [("llff_fern", 550), ("llff_flower", 1500)])
def test_three_real_photographs_give_points(name: str, least: int) -> None:
    scene = build(LLFFScene, path=data_folder(name)).load()
    found = triangulate(
        scene.train, scene.bounds, max_reprojection_error=2.0, min_angle=1.5, seed=0
    )
    assert len(found.positions) > least
    assert found.errors.mean() < 0.5
    assert scene.points is not None  # the data set's own points, from all photographs
    distance = torch.cdist(found.positions, scene.points.positions.float()).amin(dim=1)
    assert distance.median() < 0.02 * scene.bounds[1]
