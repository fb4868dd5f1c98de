"""Differences between runs of one scene and seed, with their interval."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from stereogs.experiments.planning.plan import Plan
from stereogs.experiments.running.folder import ExperimentFolder
from stereogs.experiments.showing.page import as_page
from stereogs.experiments.showing.score_table import ScoreTable
from stereogs.experiments.showing.scores import difference
from stereogs.experiments.showing.table import as_text, difference_table
from tests.host import Plugins
from tests.html_page import Page
from tests.stereogs.experiments.ablating import plan, write


def test_a_difference_is_over_pairs_of_scene_and_seed() -> None:
    baseline = {("fern", seed): 10.0 * seed + 5 for seed in range(3)}
    ours = {("fern", seed): 10.0 * seed + 5 + gain for seed, gain in enumerate((1.0, 2.0, 3.0))}
    alone = {("flower", 2): 99.0}
    found = difference(ours | alone, baseline)
    assert found is not None
    assert found.half is not None
    assert found.mean == pytest.approx(2)
    # Student's t for two degrees of freedom, 4.303, times 1 / sqrt(3).
    assert found.half == pytest.approx(2.4841, abs=1e-3)
    del ours["fern", 2]
    found = difference(ours, baseline)
    assert found is not None
    assert found.text() == "+1.50"
    assert difference(alone, baseline) is None


@pytest.fixture
def made(toys: Plugins, tmp_path: Path) -> Plan:
    """A varied number, two scenes, two seeds: 2 combinations, 8 runs."""
    return plan(write(tmp_path), toys, vary=("opacity.factor=0.5,0.6",), scenes="./a,./b", seeds=2)


def measured(made: Plan, gain: dict[tuple[str, int], float]) -> dict[Any, dict[str, Any]]:
    """Return results in which the second combination has these differences to the first."""
    first = made.combinations[0]
    own = {run: 0.0 if run.combination == first else gain[run.scene, run.seed] for run in made.runs}
    return {
        run: {"test": {"psnr": 20 + 3 * run.seed + own[run]}, "gaussians": 5, "hash": str(own[run])}
        for run in made.runs
    }


def texts(table: ScoreTable) -> list[list[str]]:
    return [[cell.text for cell in row] for row in table.rows]


GAIN = {("a", 7): 1.0, ("a", 8): 2.0, ("b", 7): 3.0, ("b", 8): 2.0}


def test_a_table_has_the_differences_to_the_first_row(made: Plan, tmp_path: Path) -> None:
    results = measured(made, GAIN)
    found = difference_table(made, results)
    assert found is not None
    assert found.head == ["factor", "psnr", "a", "b"]
    # Student's t for three degrees of freedom, 3.182, times the deviation sqrt(2 / 3) over sqrt(4).
    assert texts(found) == [["0.5", "-", "-", "-"], ["0.6", "+2.00 ± 1.30", "+1.50", "+2.50"]]
    text = " ".join(as_text(made, results).split())
    assert "toy, differences to opacity.factor 0.5" in text
    assert "+2.00 ± 1.30" in text
    assert "95% confidence interval" in text
    page = Page(as_page(made, results, ExperimentFolder(tmp_path)))
    assert "+2.00 ± 1.30" in page.text


def test_missing_and_infinite_numbers_are_not_compared(made: Plan) -> None:
    results = measured(made, GAIN)
    last = next(run for run in reversed(made.runs) if run.scene == "a")
    results[last] = {}
    found = difference_table(made, results)
    assert found is not None
    assert texts(found)[1] == ["0.6", "-", "-", "+2.50"]
    results = measured(made, {**GAIN, ("a", 7): math.inf})
    found = difference_table(made, results)
    assert found is not None
    assert texts(found)[1] == ["0.6", "+2.33 ± 1.43", "+2.00", "+2.50"]


def test_too_few_pairs_make_no_table(toys: Plugins, tmp_path: Path) -> None:
    made = plan(write(tmp_path), toys, vary=("opacity.factor=0.5,0.6",), scenes="./a", seeds=2)
    results = measured(made, GAIN)
    assert difference_table(made, results) is None
    assert "differences" not in as_text(made, results)
