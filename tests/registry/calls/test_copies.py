"""Components write into copies, and the originals keep their values."""

from __future__ import annotations

import copy
import pickle
from dataclasses import replace

import pytest
import torch

from core_rasterizer import Rendering
from registry import PluginError, View
from registry.calls.copies import copied
from registry.testing import tiny_scene


def test_writes_through_numpy_do_not_reach_the_original() -> None:
    scene = tiny_scene()
    before = scene.train[0].image.clone()
    mine = copied(scene)
    mine.train[0].image.numpy()[:] = 255
    mine.train[0].camera.world_to_camera.data.zero_()
    assert mine.points is not None
    mine.points.positions.zero_()
    assert torch.equal(scene.train[0].image, before)
    assert scene.train[0].camera.world_to_camera.any()
    assert scene.points is not None
    assert scene.points.positions.any()
    assert mine.train[0].image.max() == 255, "its own writes stay"


def test_a_copy_behaves_like_the_original() -> None:
    view = tiny_scene().train[0]
    mine = copied(view)
    assert isinstance(mine, View)
    assert (mine.name, mine.mask) == (view.name, None)
    for other in (
        replace(mine, mask=None),
        copy.deepcopy(mine),
        pickle.loads(pickle.dumps(mine)),
        copied(mine),
    ):
        assert torch.equal(other.image, view.image)
    assert mine.camera.resized(16, 12).width == 16
    with pytest.raises(PluginError, match="not available during training"):
        _ = copied(tiny_scene().for_training()).train[0].depth


def test_images_are_copied_on_first_access() -> None:
    fetched: list[str] = []

    def image(name: str) -> torch.Tensor:
        fetched.append(name)
        return torch.zeros(2, 2)

    rendering = Rendering.lazy(image)
    mine = copied(rendering)
    assert fetched == []
    mine.rgb.fill_(1)
    assert fetched == ["rgb"]
    assert not rendering.rgb.any()
