from __future__ import annotations

import torch

from core_rasterizer import Adam, apply_edit
from stereogs_plugins.densification.faint_growth import FaintGrowth
from tests.stereogs_plugins.building import build, moment_with, some_gaussians, step_with


def test_grows_by_a_twentieth_that_nobody_sees() -> None:
    step, model = moment_with(some_gaussians([0.2] * 40, [0.8] * 40))
    before = model.render(step.view.camera).rgb.detach()
    edit = build(FaintGrowth).refine(step)
    assert edit is not None
    apply_edit(model, Adam(model), edit, torch.Generator())
    assert model.count == 42
    torch.testing.assert_close(model.render(step.view.camera).rgb.detach(), before)


def test_more_may_be_added_than_there_are_and_less_than_one_is_nothing() -> None:
    step = step_with(some_gaussians([0.2] * 4, [0.8] * 4))
    assert build(FaintGrowth).refine(step) is None
    edit = build(FaintGrowth, share=1.5).refine(step)
    assert edit is not None
    assert edit.parents is not None
    assert edit.parents.tolist() == [0, 1, 2, 3, 0, 1]
