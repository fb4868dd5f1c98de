"""Training views left out one by one."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from benchmarks.left_out import folds
from core_rasterizer import Camera
from registry import RunError, Scene, View


@pytest.fixture
def scene() -> Scene:
    def view(index: int) -> View:
        camera = Camera.look_at((0.1 * index, 0.0, -4.0), (0.0, 0.0, 0.0), 8, 6, 4)
        return View(f"view{index}", camera, torch.zeros(4, 6, 3))

    views = tuple(map(view, range(4)))
    return Scene("tiny", train=views[:3], test=views[3:], bounds=(1.0, 9.0))


def test_each_training_view_is_left_out_once(scene: Scene) -> None:
    names = [view.name for view in scene.train]
    found = list(folds(scene))
    assert [fold.test[0].name for fold in found] == names
    for fold, name in zip(found, names, strict=True):
        assert len(fold.test) == 1
        assert [view.name for view in fold.train] == [other for other in names if other != name]


def test_two_views_are_too_few(scene: Scene) -> None:
    with pytest.raises(RunError, match="2 training views are too few"):
        next(folds(replace(scene, train=scene.train[:2])))
