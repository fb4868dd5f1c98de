from __future__ import annotations

import pytest

from registry import PluginError
from stereogs_plugins.densification.unseen_pruning import UnseenPruning
from tests.stereogs_plugins.building import at_depths, build, step_with


def test_what_no_training_view_shows_goes_and_what_is_hidden_stays() -> None:
    edit = build(UnseenPruning).refine(step_with(at_depths(-3, 2, 4, 9)))  # the first is behind
    assert edit.prune is not None
    assert edit.prune.tolist() == [True, False, False, False]


def test_what_is_right_before_a_camera_goes_too() -> None:
    # The near bound of this scene is 1: nearer than 0.6 times that.
    edit = build(UnseenPruning, near=0.6).refine(step_with(at_depths(0.5, 0.7, 4)))
    assert edit.prune is not None
    assert edit.prune.tolist() == [True, False, False]


def test_something_must_be_left() -> None:
    with pytest.raises(PluginError, match="no Gaussian would be left"):
        build(UnseenPruning).refine(step_with(at_depths(-3, -4)))
