from __future__ import annotations

import pytest
import torch

from core_rasterizer import Adam, apply_edit
from stereogs_plugins.densification.relocation import DeadRelocation
from tests.stereogs_plugins.building import build, moment_with, some_gaussians, step_with


def test_the_dead_become_copies_in_proportion_to_opacity() -> None:
    opacities = [0.004] * 3000 + [0.2, 0.6]
    step = step_with(some_gaussians([0.02] * len(opacities), opacities))
    edit = build(DeadRelocation).refine(step)
    assert edit is not None
    assert edit.relocate is not None
    assert edit.relocate.target.tolist() == list(range(3000))
    drawn = torch.bincount(edit.relocate.source, minlength=3002)
    assert int(drawn[:3000].sum()) == 0
    assert float(drawn[3001]) / 3000 == pytest.approx(0.75, abs=0.03)


def test_a_copy_and_its_source_share_the_opacity_of_the_one_that_was() -> None:
    step, model = moment_with(some_gaussians([0.02, 0.02], [0.001, 0.64]))
    edit = build(DeadRelocation).refine(step)
    assert edit is not None
    apply_edit(model, Adam(model), edit, torch.Generator())
    # 1 - (1 - 0.64)^(1/2), the paper's equation 9
    torch.testing.assert_close(model.opacities(), torch.full((2,), 0.4))


@pytest.mark.parametrize("opacities", [[0.5, 0.5], [0.001, 0.001]])
def test_nothing_moves_where_nobody_is_dead_or_all_are(opacities: list[float]) -> None:
    assert build(DeadRelocation).refine(step_with(some_gaussians([0.02] * 2, opacities))) is None
