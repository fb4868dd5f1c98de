"""The skips campaign: its switches, tables and picture."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.skips_page import PICTURE, draw, tables
from benchmarks.skips_plan import CASES, DEFAULT, SHORTCUTS, Shortcut, planned_runs, variant
from benchmarks.trainings import Method
from tests.benchmarks.made import record, rows_of
from tests.host import Plugins


def test_a_switch_is_compared_with_the_default_of_its_own_scene_and_seed(tmp_path: Path) -> None:
    methods = {name: Method(name, Path("a.yaml")) for name in (DEFAULT, "half")}
    found = [
        record(
            methods[switch],
            CASES[scene],
            seed,
            psnr,
            process_cpu_seconds=seconds,
            gaussians=gaussians,
        )
        for switch, scene, seed, seconds, psnr, gaussians in (
            (DEFAULT, "fern-3", 0, 40.0, 20.0, 1000),
            (DEFAULT, "fern-3", 1, 60.0, 21.0, 1000),
            ("half", "fern-3", 0, 20.0, 19.5, 500),
            ("half", "fern-3", 1, 45.0, 20.7, 700),
            ("half", "lego-8", 0, 45.0, 20.7, 700),
        )
    ]
    first, second = rows_of(tables(found, 5))[2:]
    assert first == [DEFAULT, "fern-3", "50.0", "", "20.50 ± 0.71", "", "0.500", "1,000", "2"]
    assert second[:4] == ["half", "fern-3", "32.5", "+38%"]
    assert second[4:] == ["20.10 ± 0.85", "-0.40 ± 0.14", "0.500", "600", "2"]
    draw(found, tmp_path)
    assert (tmp_path / PICTURE).stat().st_size > 1000


@pytest.mark.parametrize("switch", SHORTCUTS, ids=lambda switch: switch.label)
def test_every_switch_changes_the_pipeline(switch: Shortcut) -> None:
    made = [variant(one, Plugins()).as_written() for one in (switch, SHORTCUTS[0])]
    assert (made[0] == made[1]) == (switch.label == DEFAULT)


def test_switches_take_turns() -> None:
    runs = planned_runs(Plugins(), seeds=(1,))
    assert len({run.name for run in runs}) == len(runs) == len(CASES) * len(SHORTCUTS)
    places = [(run.case, run.method.title) for run in runs]
    assert places == [(case, switch.label) for case in CASES.values() for switch in SHORTCUTS]
    assert {run.pipeline.training.seed for run in runs} == {1}
    half = runs[1].pipeline
    assert half.iterations_per_view is not None
    assert runs[0].pipeline.iterations_per_view == 2 * half.iterations_per_view
