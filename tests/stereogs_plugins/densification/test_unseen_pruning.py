from __future__ import annotations

import pytest
import torch

from core_rasterizer import Gaussians
from registry import PluginError
from registry.testing import check
from stereogs_plugins.densification.unseen_pruning import (
    UnseenPruning,
    stereogs_register_densifications,
)
from tests.stereogs_plugins.building import build, offered, step_with


def along_z(*depths: float) -> Gaussians:
    count = len(depths)
    positions = torch.zeros(count, 3)
    positions[:, 2] = torch.tensor(depths)
    return Gaussians.from_points(
        positions,
        torch.full((count, 3), 0.5),
        torch.full((count,), 0.1),
        torch.full((count,), 0.5),
        0,
    )


def test_it_is_registered_and_keeps_the_contract() -> None:
    assert offered(stereogs_register_densifications) == {"unseen_pruning": UnseenPruning}
    check(UnseenPruning)


def test_what_no_training_view_shows_goes_and_what_is_hidden_stays() -> None:
    edit = build(UnseenPruning).refine(step_with(along_z(-3, 2, 4, 9)))  # the first is behind
    assert edit.prune is not None
    assert edit.prune.tolist() == [True, False, False, False]


def test_what_is_right_before_a_camera_goes_too() -> None:
    # The near bound of this scene is 1: nearer than 0.6 times that.
    edit = build(UnseenPruning, near=0.6).refine(step_with(along_z(0.5, 0.7, 4)))
    assert edit.prune is not None
    assert edit.prune.tolist() == [True, False, False]


def test_something_must_be_left() -> None:
    with pytest.raises(PluginError, match="no Gaussian would be left"):
        build(UnseenPruning).refine(step_with(along_z(-3, -4)))
