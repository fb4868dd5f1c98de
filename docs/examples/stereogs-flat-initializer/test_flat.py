"""Tests by the author of a plugin: the contract, and the purpose of the component."""

import torch
from stereogs_flat_initializer import FlatInitializer, FlatSettings

from core_rasterizer import open_device
from stereogs import api
from stereogs.testing import check, tiny_scene


def test_it_keeps_the_contract() -> None:
    check(FlatInitializer, points_per_view=50)


def test_points_lie_on_the_plane() -> None:
    scene = tiny_scene()
    settings = FlatSettings(points_per_view=50, depth=1.0)
    points = FlatInitializer(settings, api.Context("flat", 0, open_device())).initialize(scene, {})
    torch.testing.assert_close(points.positions[:, 2], torch.full((100,), scene.bounds[1]))
