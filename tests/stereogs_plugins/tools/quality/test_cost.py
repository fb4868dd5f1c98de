"""Estimates from measured costs, and the error for too few seconds."""

from __future__ import annotations

import pytest

from registry import RunError
from stereogs_plugins.tools.quality.fitting import Cost

COST = Cost(spent=4.0, iteration=0.05, after=1.0)


def test_iterations_that_fit_into_seconds() -> None:
    assert COST.iterations(20) == 300
    assert COST.seconds(300) == pytest.approx(20)
    assert COST.iterations(20.04) == 300, "a part of an iteration is none"
    assert COST.iterations(3) < 1


def test_too_few_seconds_are_an_error_with_the_seconds_needed() -> None:
    COST.require(50, 7.6)
    with pytest.raises(RunError) as refused:
        COST.require(50, 7.4)
    assert "7.4 s are too few: loading and initialization took 4.0 s" in refused.value.what
    assert refused.value.where == "--seconds"
    assert "allow at least 8 s, for 50 iterations" in refused.value.fix
