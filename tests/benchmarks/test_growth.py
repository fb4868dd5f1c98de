from __future__ import annotations

import pytest

from benchmarks.growth import STAGES, exponent, table

COLUMNS = ("cpu", *STAGES.values(), "memory_mb", "folder_mb")


def test_the_exponent_is_that_of_a_power() -> None:
    record = {str(views): dict.fromkeys(COLUMNS, 0.01 * views**1.5) for views in (3, 50, 300)}
    assert exponent(record, "cpu") == pytest.approx(1.5)
    *rows, last = table(record).splitlines()
    assert last.startswith("| exponent, 50 to 300 | 1.50 | 1.50 |")
    assert [row.split(" | ")[0] for row in rows[2:]] == ["| 3", "| 50", "| 300"]
