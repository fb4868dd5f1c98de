"""The parts campaign: its plan, groups of runs that share a process, and the tables."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from benchmarks.branches import shared_iterations
from benchmarks.cells import NONE
from benchmarks.parts_page import tables
from benchmarks.parts_plan import (
    EIGHT,
    LATE,
    NOTHING,
    OBJECTS,
    TABLES,
    TERM_TABLE,
    PartsRun,
    planned_runs,
    shared_groups,
)
from benchmarks.training_records import Record
from tests.host import Plugins

PLUGINS = Plugins()
ALL = "initializer, stereo_depth, opacity"


@pytest.fixture(autouse=True)
def _folders(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STEREOGS_DATA", "data")
    monkeypatch.setenv("STEREOGS_MODELS", "models")


def labels(run: PartsRun) -> dict[str, str]:
    return {row.table: row.label for row in run.rows}


def test_every_table_has_its_rows_on_its_scenes_and_shares_runs() -> None:
    runs = planned_runs(TABLES, PLUGINS, seeds=(0,))
    assert len({run.name for run in runs}) == len(runs)
    for table in TABLES:
        for case in table.cases:
            rows = [run for run in runs if run.case is case and table.title in labels(run)]
            named = [label for _, only in table.files for label in only]
            found = {labels(run)[table.title] for run in rows}
            assert set(named) | {table.baseline} <= found
            assert all(
                run.pipeline.protocol.written == case.protocol
                for run in rows
                if run.pipeline.protocol
            )
    (whole,) = [
        run for run in runs if labels(run).get(EIGHT.title) == ALL and run.case == EIGHT.cases[0]
    ]
    assert labels(whole) == {
        EIGHT.title: ALL,
        TERM_TABLE.title: "as in the paper",
        "The decay functions": "exp_beta",
        "The first points": "itermvs",
    }


def test_runs_are_sorted_by_seed() -> None:
    runs = planned_runs([EIGHT, TERM_TABLE], PLUGINS, seeds=(0, 1))
    assert [run.seed for run in runs] == sorted(run.seed for run in runs)
    eight = [run.seed for run in runs if EIGHT.title in labels(run)]
    assert eight.count(0) == eight.count(1) == 8 * len(EIGHT.cases)


def test_runs_of_one_process_share_their_first_iterations() -> None:
    runs = planned_runs(TABLES, PLUGINS, seeds=(0, 1))
    groups = shared_groups(runs)
    assert sorted(run.name for group in groups for run in group) == sorted(run.name for run in runs)
    for group in groups:
        assert len({(run.case.data, run.seed) for run in group}) == 1
        if len(group) > 1:
            whole = group[0].pipeline.training.iterations
            assert shared_iterations([run.pipeline for run in group]) > 0.6 * whole
    largest = max(groups, key=len)
    assert {labels(run).get(EIGHT.title) for run in largest} >= {"initializer, opacity", ALL}
    alone = [
        group for group in groups if labels(group[0]).get(TERM_TABLE.title, "").startswith("from a")
    ]
    assert alone
    assert all(len(group) == 1 for group in alone)


def test_runs_of_a_group_differ_in_late_items_only() -> None:
    for group in shared_groups(planned_runs([EIGHT, TERM_TABLE], PLUGINS, seeds=(0,))):
        first, *others = (
            {item.qualified_name: item for item in run.pipeline if item.qualified_name not in LATE}
            for run in group
        )
        assert all(other == first for other in others)


def test_the_digest_does_not_depend_on_the_location_of_the_data(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (here, *_) = planned_runs([EIGHT], PLUGINS, seeds=(0,))
    monkeypatch.setenv("STEREOGS_DATA", str(Path("else", "where")))
    monkeypatch.setenv("STEREOGS_MODELS", "other-models")
    (there, *_) = planned_runs([EIGHT], PLUGINS, seeds=(0,))
    assert here.pipeline.to_yaml() != there.pipeline.to_yaml()
    assert here.digest == there.digest
    assert here.trunk == there.trunk


def records_of(psnr: dict[str, float]) -> list[Record[PartsRun]]:
    """A record of each row of the first two tables that has a number; seeds shift it."""
    measured: dict[str, Any] = {
        "gaussians": 12_345,
        "seconds": 100.0,
        "device": {"name": "a processor"},
    }
    without_stereo, with_stereo = (
        {},
        {
            "stereo_depth_inferences": 12.0,
            "stereo_depth_seconds": 10.0,
            "stereo_depth_baseline": 5.0,
        },
    )
    found = []
    for run in planned_runs([EIGHT, TERM_TABLE, OBJECTS], PLUGINS):
        label = labels(run).get(EIGHT.title) or labels(run).get(TERM_TABLE.title)
        if label in psnr:
            scores = {
                "psnr": psnr[label] + run.seed,
                "ssim": 0.5,
                "lpips": 0.25,
                "lpips_alex": 0.125,
                "avge": 0.0625,
            }
            logged = with_stereo if run.parts_at else without_stereo
            found.append(Record(run, measured | {"scores": scores, "logged": logged}))
    return found


def rows_of(text: str, heading: str) -> list[list[str]]:
    part = text.split(f"## {heading}\n")[1].split("##")[0]
    lines = [line for line in part.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


def test_tables_show_means_differences_and_the_papers_numbers() -> None:
    text = tables(records_of({NOTHING: 18.0, "initializer, opacity": 20.5, ALL: 20.75}), 99)
    nothing, both, whole = rows_of(text, EIGHT.title)
    assert nothing[:7] == ["✗", "✗", "✗", "3 + 3", "19.00 ± 1.00", "19.00 ± 1.00", NONE]
    assert both[:3] == ["✓", "✗", "✓"]
    assert whole[6:] == ["+2.75 ± 0.00", "0.500", "0.250", "0.125", "0.062", "12,345", "21.91"]
    parts = {(row[0], row[1]): row[2:] for row in rows_of(text, "Gain of each part")}
    assert parts["stereo depth", "dense points and decay"] == ["+0.25 ± 0.00", NONE, "+0.73"]
    assert parts["decay", NOTHING] == [NONE, NONE, "+2.16"]
    assert "18 of 99 runs, on a processor" in text
    assert f"## {TERM_TABLE.title}" not in text  # all of its rows are in the tables above
    assert "## Around objects" not in text


def test_the_stereo_term_is_shown_with_its_inferences() -> None:
    text = tables(records_of({"initializer, opacity": 20.5, ALL: 20.75, "sgm": 20.25}), 99)
    none, sgm, paper = rows_of(text, TERM_TABLE.title)
    assert none[:5] == ["none", "3 + 3", "21.50 ± 1.00", "21.50 ± 1.00", NONE]
    assert none[-2:] == [NONE, NONE]
    assert sgm[0] == "sgm"
    assert sgm[4] == "-0.25 ± 0.00"
    assert paper[0] == "as in the paper"
    assert paper[4] == "+0.25 ± 0.00"
    assert paper[-2:] == ["12", "10%"]
