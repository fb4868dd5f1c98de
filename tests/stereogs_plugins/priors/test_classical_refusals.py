"""Classical multi-view depth priors with cameras that do not determine depth."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import torch

from registry import PluginError
from registry.priors import MultiViewDepthPrior
from registry.testing import tiny_scene
from stereogs_plugins.priors.patch_match import PatchMatchPrior
from stereogs_plugins.priors.plane_sweep import PlaneSweep
from tests.stereogs_plugins.building import build

both = pytest.mark.parametrize("prior", [PatchMatchPrior, PlaneSweep])


@both
def test_cameras_at_one_position_are_an_error(prior: type[MultiViewDepthPrior[Any]]) -> None:
    scene = tiny_scene()
    views = (scene.train[0], replace(scene.train[0], name="twin"))
    with pytest.raises(PluginError, match="2 cameras are at the same position"):
        build(prior).depths(views, scene.bounds)


@both
def test_views_that_do_not_overlap_have_no_valid_depth(
    prior: type[MultiViewDepthPrior[Any]],
) -> None:
    scene = tiny_scene()
    here = scene.train[0].camera
    backwards = torch.diag(torch.tensor([-1.0, 1.0, -1.0, 1.0], dtype=torch.float64))
    away = replace(here, world_to_camera=backwards @ here.shifted_right(1).world_to_camera)
    views = (scene.train[0], replace(scene.train[1], camera=away))
    for answer in build(prior).depths(views, scene.bounds):
        assert not answer.valid.any()
        assert not answer.depth.any()
