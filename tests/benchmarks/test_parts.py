"""The parts campaign: its plan and the tables."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest

from benchmarks.cells import NONE
from benchmarks.parts_page import tables
from benchmarks.parts_plan import (
    EIGHT,
    NOTHING,
    OBJECTS,
    TABLES,
    TERM_TABLE,
    PartsTraining,
    planned_runs,
)
from benchmarks.records import Record
from tests.benchmarks.made import MEASURED, SCORES, rows_of
from tests.host import Plugins

PLUGINS = Plugins()
ALL = "initializer, stereo_depth, opacity"


def labels(run: PartsTraining) -> dict[str, str]:
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


def test_the_digest_does_not_depend_on_the_location_of_the_data(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (here, *_) = planned_runs([EIGHT], PLUGINS, seeds=(0,))
    monkeypatch.setenv("STEREOGS_DATA", str(Path("else", "where")))
    monkeypatch.setenv("STEREOGS_MODELS", "other-models")
    (there, *_) = planned_runs([EIGHT], PLUGINS, seeds=(0,))
    assert here.pipeline.to_yaml() != there.pipeline.to_yaml()
    assert here.digest == there.digest


@cache
def planned() -> list[PartsTraining]:
    """The runs of the first two tables and of the objects, of every seed."""
    return planned_runs([EIGHT, TERM_TABLE, OBJECTS], PLUGINS)


def test_runs_are_sorted_by_seed() -> None:
    runs = planned()
    assert [run.seed for run in runs] == sorted(run.seed for run in runs)
    eight = [run.seed for run in runs if EIGHT.title in labels(run)]
    assert eight.count(0) == eight.count(1) == 8 * len(EIGHT.cases)


def records_of(psnr: dict[str, float]) -> list[Record[PartsTraining]]:
    """A record of each row of the first two tables that has a number; seeds shift it."""
    term = {
        "stereo_depth_inferences": 12.0,
        "stereo_depth_seconds": 10.0,
        "stereo_depth_baseline": 5.0,
    }
    found = []
    for run in planned():
        label = labels(run).get(EIGHT.title) or labels(run).get(TERM_TABLE.title)
        if label in psnr:
            scores = {"psnr": psnr[label] + run.seed, **SCORES, "lpips_alex": 0.0625}
            names = [item.name for item in run.pipeline.items["regularizers"]]
            logged = term if "stereo_depth" in names else {}
            found.append(Record(run, {**MEASURED, "scores": scores, "logged": logged}))
    return found


def lines_of(text: str, heading: str) -> list[list[str]]:
    return rows_of(text.split(f"## {heading}\n")[1].split("##")[0])[2:]


def test_tables_show_means_differences_and_the_papers_numbers() -> None:
    text = tables(records_of({NOTHING: 18.0, "initializer, opacity": 20.5, ALL: 20.75}), 99)
    nothing, both, whole = lines_of(text, EIGHT.title)
    assert nothing[:7] == ["✗", "✗", "✗", "3 + 3", "19.00 ± 1.00", "19.00 ± 1.00", NONE]
    assert both[:3] == ["✓", "✗", "✓"]
    assert whole[6:] == ["+2.75 ± 0.00", "0.500", "0.250", "0.062", "0.125", "12,345", "21.91"]
    parts = {(row[0], row[1]): row[2:] for row in lines_of(text, "Gain of each part")}
    assert parts["stereo depth", "dense points and decay"] == ["+0.25 ± 0.00", NONE, "+0.73"]
    assert parts["decay", NOTHING] == [NONE, NONE, "+2.16"]
    assert "18 of 99 runs, on a processor" in text
    assert f"## {TERM_TABLE.title}" not in text  # all of its rows are in the tables above
    assert "## Around objects" not in text


def test_the_stereo_term_is_shown_with_its_inferences() -> None:
    text = tables(records_of({"initializer, opacity": 20.5, ALL: 20.75, "sgm": 20.25}), 99)
    none, sgm, paper = lines_of(text, TERM_TABLE.title)
    assert none[:5] == ["none", "3 + 3", "21.50 ± 1.00", "21.50 ± 1.00", NONE]
    assert none[-2:] == [NONE, NONE]
    assert sgm[0] == "sgm"
    assert sgm[4] == "-0.25 ± 0.00"
    assert paper[0] == "as in the paper"
    assert paper[4] == "+0.25 ± 0.00"
    assert paper[-2:] == ["12", "10%"]
