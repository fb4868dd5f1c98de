"""Tables of `make bench-skips`, and its switches."""

from __future__ import annotations

import pytest

from benchmarks.skips import DEFAULT, SWITCHES, variant
from benchmarks.skips_table import Measured, rows, summary, table
from tests.host import Plugins, build_pipeline


def test_a_switch_is_compared_with_the_default_of_its_own_scene_and_seed() -> None:
    found = rows(
        [
            Measured("as it is", "a", 0, 40.0, 20.0, 0.7, 1000),
            Measured("as it is", "a", 1, 60.0, 21.0, 0.7, 1000),
            Measured("half", "a", 0, 20.0, 19.5, 0.65, 500),
            Measured("half", "a", 1, 45.0, 20.7, 0.65, 700),
            Measured("half", "b", 0, 45.0, 20.7, 0.65, 700),
        ],
        "as it is",
    )
    assert table(found).splitlines()[2:] == [
        "| as it is | a | 50.0 |  | 20.50 ± 0.71 |  | 0.700 | 1,000 | 2 |",
        "| half | a | 32.5 | +38% | 20.10 ± 0.85 | -0.40 ± 0.14 | 0.650 | 600 | 2 |",
    ]
    assert summary([row for row in found if row.scene == "a"], "as it is").splitlines()[2:] == [
        "| half | +38% | -0.40 ± 0.14 |"
    ]


@pytest.mark.parametrize("switch", SWITCHES, ids=lambda switch: switch.label)
def test_every_switch_changes_the_pipeline(switch: object) -> None:
    plugins = Plugins()
    trees = [variant(which, 40, plugins) for which in (switch, SWITCHES[0])]  # type: ignore[arg-type]
    texts = [build_pipeline(tree, plugins).to_yaml() for tree in trees]
    assert (texts[0] == texts[1]) == (switch.label == DEFAULT)  # type: ignore[attr-defined]
