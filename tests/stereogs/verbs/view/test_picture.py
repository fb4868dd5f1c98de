"""Which Gaussians are rendered, and in which size."""

from __future__ import annotations

import numpy as np
import torch

from core_rasterizer import Camera, Device, GaussianModel, Gaussians
from registry.confidence import Confidence
from stereogs.verbs.view.picture import Box, Look, Pace, render, visible
from stereogs.verbs.view.subject import Subject


def test_hidden_kinds_and_the_crop_box_combine(device: Device) -> None:
    positions = torch.tensor([[0.0, 0, 1], [0, 0, 2], [0, 0, 3], [5, 0, 2]])
    ones = torch.full((4,), 0.1)
    gaussians = Gaussians.from_points(positions, torch.full((4, 3), 0.5), ones, ones, 0)
    kinds = {"guessed": torch.tensor([False, True, False, False])}
    subject = Subject("x", GaussianModel(gaussians, device), kinds=kinds)
    none = torch.zeros(4, dtype=torch.bool)
    assert visible(subject, Look(), none) is None
    box = Box((-1.0, -1.0, 0.0), (1.0, 1.0, 2.5))
    inside = visible(subject, Look(box=box), none)
    assert inside is not None
    assert inside.tolist() == [True, True, False, False]
    both = visible(subject, Look(hidden=("guessed",), box=box), none)
    assert both is not None
    assert both.tolist() == [True, False, False, False]
    rest = visible(subject, Look(box=box), torch.tensor([True, False, False, False]))
    assert rest is not None
    assert rest.tolist() == [False, True, False, False]


def test_sizes_keep_the_aspect_ratio_and_fit_the_time() -> None:
    pace = Pace()
    for _ in range(20):
        pace.add(100_000, 1.0)
    width, height = pace.size(1600, 800, 1.0)
    assert abs(width - 2 * height) <= 2
    assert 90_000 < width * height < 110_000


def test_a_fast_machine_renders_at_most_the_window_size() -> None:
    pace = Pace()
    for _ in range(20):
        pace.add(1_000_000, 0.001)
    assert pace.size(640, 480, 0.1) == (640, 480)


def test_a_slow_machine_renders_the_smallest_size() -> None:
    pace = Pace()
    for _ in range(40):
        pace.add(100, 10.0)
    width, height = pace.size(1600, 1200, 0.08)
    assert width * height > 19_000


class LeftHalf(Confidence):
    """Sure of the right half only."""

    def of(self, camera: Camera) -> torch.Tensor:
        values = torch.ones(camera.height, camera.width)
        values[:, : camera.width // 2] = 0
        return values


def test_guesses_are_hatched_and_the_rest_is_as_rendered(device: Device) -> None:
    camera = Camera.centered(np.eye(4), 20.0, 40, 30)
    ones = torch.full((1,), 0.5)
    positions, colors = torch.tensor([[0.0, 0, 1]]), torch.full((1, 3), 0.5)
    model = GaussianModel(Gaussians.from_points(positions, colors, ones, ones, 0), device)
    subject = Subject("x", model, confidence=LeftHalf)
    plain, _ = render(subject, camera, "colours")
    marked, _ = render(subject, camera, "guesses hatched")
    assert (marked[:, 22:] == plain[:, 22:]).all()
    assert (marked[:, :18] != plain[:, :18]).any(axis=2).mean() > 0.9
