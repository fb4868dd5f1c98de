"""Angles between a view and the training views."""

from __future__ import annotations

import math

import pytest
import torch

from core_rasterizer import Camera
from registry.toolkit.views import subject_of, view_angles

ORIGIN = torch.zeros(3)


def at(degrees: float, height: float = 0.0) -> Camera:
    """A camera on a circle around the origin, at a height."""
    angle = math.radians(degrees)
    eye = (4 * math.sin(angle), height, 4 * math.cos(angle))
    return Camera.look_at(eye, (0.0, 0.0, 0.0), 80, 64, 48)


TRAINING = [at(0), at(20), at(50)]


@pytest.mark.parametrize(
    ("degrees", "nearest", "outside"), [(20, 0, 0), (8, 8, 0), (36, 14, 0), (65, 15, 15)]
)
def test_on_an_arc(degrees: float, nearest: float, outside: float) -> None:
    found = view_angles(at(degrees), TRAINING, ORIGIN)
    assert found.nearest == pytest.approx(nearest, abs=0.01)
    assert found.outside == pytest.approx(outside, abs=0.01)


def test_a_camera_above_the_arc_is_outside_by_its_elevation() -> None:
    found = view_angles(at(20, height=4.0), TRAINING, ORIGIN)
    assert found.outside == pytest.approx(45, abs=0.01)
    assert found.nearest == pytest.approx(45, abs=0.01)


def test_the_subject_is_at_the_median_depth_in_view() -> None:
    camera = at(0)
    points = torch.tensor([[0, 0, 2.0], [0, 0, 1.0], [0.1, 0, 0.5], [50, 0, 3.9], [0, 0, 9.0]])
    assert subject_of(camera, (1, 9), points) == pytest.approx([0, 0, 1.0], abs=1e-6)
    assert subject_of(camera, (1, 9)) == pytest.approx([0, 0, 1.0], abs=1e-6)  # depth 3
