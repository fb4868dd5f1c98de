"""Steps between the marks of an axis."""

from __future__ import annotations

import pytest

from registry.toolkit.drawing.axis_ticks import round_step


@pytest.mark.parametrize(("wanted", "step"), [(0.9, 1), (1, 1), (1.1, 2), (2.1, 5), (0.06, 0.1)])
def test_steps_are_round(wanted: float, step: float) -> None:
    assert round_step(wanted) == pytest.approx(step)
