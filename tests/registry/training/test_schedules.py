"""Learning rates over a training, and the order of its views."""

from __future__ import annotations

import pytest

from registry.training.step import learning_rates
from registry.training.trainer import ViewOrder
from tests.host import LearningRates, TrainingSettings


def test_position_rate_falls_log_linearly() -> None:
    settings = TrainingSettings(iterations=1000)
    assert learning_rates(1000, settings, 2.0)["means"] == pytest.approx(2 * 1.6e-6)
    assert learning_rates(500, settings, 1.0)["means"] == pytest.approx(1.6e-5)
    short = TrainingSettings(iterations=1000, learning_rates=LearningRates(position_steps=100))
    assert learning_rates(100, short, 1.0)["means"] == pytest.approx(1.6e-6)
    assert learning_rates(900, short, 1.0)["means"] == pytest.approx(1.6e-6)


def test_rates_of_zero_are_possible() -> None:
    rates = LearningRates(position_final=0)
    settings = TrainingSettings(iterations=100, learning_rates=rates)
    assert learning_rates(100, settings, 1.0)["means"] == 0
    assert learning_rates(50, settings, 1.0)["means"] == pytest.approx(0.8e-4)


def test_the_other_rates_end_in_their_share_along_half_a_cosine() -> None:
    settings = TrainingSettings(iterations=100, learning_rates=LearningRates(final_share=0.2))
    known = {"sh_constant": 2.5e-3, "opacity_logits": 0.05, "log_scales": 5e-3, "quaternions": 1e-3}
    for iteration, share in ((50, 0.6), (75, 0.2 + 0.8 * (1 - 2**-0.5) / 2), (100, 0.2)):
        rates = learning_rates(iteration, settings, 1.0)
        for name, rate in known.items():
            assert rates[name] == pytest.approx(share * rate), (iteration, name)
        plain = learning_rates(iteration, TrainingSettings(iterations=100), 1.0)
        assert rates["means"] == plain["means"]
        assert plain["sh_constant"] == 2.5e-3  # without a share, to the last bit


def test_views_come_without_replacement() -> None:
    order = ViewOrder(5, seed=3)
    rounds = [[order.next() for _ in range(5)] for _ in range(20)]
    assert all(sorted(views) == [0, 1, 2, 3, 4] for views in rounds)
    assert len({tuple(views) for views in rounds}) > 10
