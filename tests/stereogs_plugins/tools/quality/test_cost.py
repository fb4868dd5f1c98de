"""Seconds from what was measured, and the answer where they are too few."""

from __future__ import annotations

import pytest

from registry import RunError
from stereogs_plugins.tools.quality.cost import Cost

COST = Cost(spent=4.0, iteration=0.05, after=1.0)


def test_as_many_iterations_as_fit() -> None:
    assert COST.iterations(20) == 300
    assert COST.seconds(300) == pytest.approx(20)
    assert COST.iterations(20.04) == 300, "a part of an iteration is none"
    assert COST.iterations(3) < 1


def test_too_few_seconds_are_refused_with_what_would_do() -> None:
    COST.refuse_too_little(7.6, least=50)
    with pytest.raises(RunError) as refused:
        COST.refuse_too_little(7.4, least=50)
    assert "7.4 s are too few: photographs and first points took 4.0 s" in refused.value.what
    assert refused.value.where == "--seconds"
    assert "about 8 s are the least here, for 50 iterations" in refused.value.fix
