from __future__ import annotations

import pytest
import torch

from stereogs_plugins.modifiers.dropout import Dropout, stereogs_register_modifiers
from tests.stereogs_plugins.building import build, offered, some_gaussians, step_with

COUNT = 20_000


def test_is_offered_as_dropout() -> None:
    assert offered(stereogs_register_modifiers) == {"dropout": Dropout}


@pytest.mark.parametrize(("ramp", "share"), [(False, 0.3), (True, 0.15)])
def test_leaves_out_its_share_and_keeps_the_mean(ramp: bool, share: float) -> None:
    step = step_with(some_gaussians([0.01] * COUNT, [0.5] * COUNT), iteration=500)
    scale = build(Dropout, ramp=ramp).opacity_scale(step)
    assert scale.shape == (COUNT,)
    assert float((scale == 0).float().mean()) == pytest.approx(share, abs=0.015)
    assert float(scale.mean()) == pytest.approx(1, abs=0.02)
    plain = build(Dropout, ramp=ramp, compensate=False).opacity_scale(step)
    assert set(plain.unique().tolist()) == {0.0, 1.0}
    assert torch.equal(plain > 0, scale > 0)


def test_draws_anew_each_time_and_nothing_at_rate_zero() -> None:
    step = step_with(some_gaussians([0.01] * 101, [0.5] * 101))
    dropout = build(Dropout)
    assert not torch.equal(dropout.opacity_scale(step), dropout.opacity_scale(step))
    assert (build(Dropout, rate=0.0).opacity_scale(step) == 1).all()
