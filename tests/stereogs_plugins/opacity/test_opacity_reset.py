from __future__ import annotations

from dataclasses import replace

import torch

from stereogs_plugins.opacity.opacity_reset import (
    OpacityReset,
    stereogs_register_opacity_policies,
)
from tests.stereogs_plugins.building import build, offered, some_gaussians, step_with


def test_is_offered_as_opacity_reset() -> None:
    assert offered(stereogs_register_opacity_policies) == {"opacity_reset": OpacityReset}


def test_lowers_to_the_ceiling_and_forgets_the_moments() -> None:
    step = step_with(some_gaussians([0.05, 0.05], [0.8, 0.006]))
    update = build(OpacityReset).update(step)
    assert update is not None
    torch.testing.assert_close(update.opacities, torch.tensor([0.01, 0.006]))
    assert update.reset_moments
    higher = build(OpacityReset, ceiling=0.05).update(step)
    assert higher is not None
    torch.testing.assert_close(higher.opacities, torch.tensor([0.05, 0.006]))


def test_nothing_is_reset_so_late_that_opacities_could_not_recover() -> None:
    step = step_with(some_gaussians([0.05, 0.05], [0.8, 0.006]), iteration=501)
    assert build(OpacityReset).update(step) is None
    assert build(OpacityReset, recovery=499).update(step) is not None


def test_may_wait_for_a_white_background() -> None:
    step = step_with(some_gaussians([0.05, 0.05], [0.8, 0.006]))
    policy = build(OpacityReset, only_on_white=True)
    assert policy.update(step) is None
    step = replace(step, scene=replace(step.scene, background=(1.0, 1.0, 1.0)))
    assert policy.update(step) is not None
