"""Seconds of iterations, from those measured in each quarter of a run."""

from __future__ import annotations

import pytest

from stereogs.quality.rehearsal import Measured

MEASURED = Measured((0.1, 0.1, 0.2, 0.4), after=1.0, gaussians=10)


def test_iterations_cost_what_their_quarter_costs() -> None:
    assert MEASURED.iteration == pytest.approx(0.2)
    assert MEASURED.seconds(0, 100, 100) == pytest.approx(100 * MEASURED.iteration)
    assert MEASURED.seconds(0, 10, 100) == pytest.approx(1.0)
    assert MEASURED.seconds(40, 80, 100) == pytest.approx(10 * 0.1 + 25 * 0.2 + 5 * 0.4)
