"""The methods campaign: its plan and its tables."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import yaml

from benchmarks import methods_page, records
from benchmarks.cells import NONE
from benchmarks.methods_plan import (
    AUTHORS_SETTINGS,
    BASELINE,
    GROUPS,
    METHODS,
    NETWORKED,
    planned_run,
    planned_runs,
)
from stereogs import Pipeline
from tests.benchmarks.made import record, row_of, rows_of
from tests.host import Plugins

PLUGINS = Plugins()
FACING, OBJECTS = GROUPS
FERN, FLOWER = FACING.cases
DROPGAUSSIAN = next(method for method in METHODS if method.paper == "dropgaussian")


def test_runs_are_sorted_by_seed_and_networks_come_last() -> None:
    some = (*NETWORKED, BASELINE)
    runs = planned_runs(some, [replace(FACING, seeds=(0, 1))], PLUGINS)
    assert [run.seed for run in runs] == sorted(run.seed for run in runs)
    first = [run.method in NETWORKED for run in runs if run.seed == 0]
    assert first == sorted(first)
    columns = sum(len(method.points) for method in some)
    assert len({run.name for run in runs}) == len(runs) == columns * len(FACING.cases) * 2
    assert {(run.pipeline.training.seed, run.case) for run in runs} == {
        (seed, case) for seed in (0, 1) for case in FACING.cases
    }


def test_objects_have_one_seed_and_precede_the_second() -> None:
    runs = planned_runs((BASELINE,), GROUPS, PLUGINS)
    around = [run for run in runs if run.case in OBJECTS.cases]
    assert [run.case.data for run in around] == ["dtu_scan24", "dtu_scan65", "blender_lego"]
    assert {(run.points, run.seed) for run in around} == {("same", 0)}
    assert [run.seed for run in runs] == sorted(run.seed for run in runs)
    for run in around:
        assert run.pipeline.protocol is not None
        assert run.pipeline.protocol.written == run.case.protocol


def test_every_first_seed_has_a_record_of_its_pipeline() -> None:
    groups = [replace(group, seeds=group.seeds[:1]) for group in GROUPS]
    runs = planned_runs(METHODS, groups, PLUGINS)
    recorded = records.read(runs, records.RECORDS / "methods.jsonl")
    assert [record.run.name for record in recorded] == [run.name for run in runs]


def test_objects_use_the_settings_of_the_authors() -> None:
    written = yaml.safe_load(AUTHORS_SETTINGS.read_text(encoding="utf-8"))
    by_name = {method.file.stem: method for method in METHODS}
    facing, around = FERN, {case.protocol.partition("-")[0]: case for case in OBJECTS.cases}
    assert set(written) <= set(around)
    for data, of_methods in written.items():
        for name, settings in of_methods.items():
            around_objects = planned_run(by_name[name], "same", around[data], 0, PLUGINS).pipeline
            on_llff = planned_run(by_name[name], "same", facing, 0, PLUGINS).pipeline
            assert around_objects.training.iterations == on_llff.training.iterations
            changed = {path.partition(".")[0] for path in settings}
            unlike = {
                section
                for section in changed
                if section_of(around_objects, section) != section_of(on_llff, section)
            }
            assert unlike == changed, (data, name)


def section_of(pipeline: Pipeline, section: str) -> object:
    return yaml.safe_load(pipeline.to_yaml())[section]


def test_the_same_points_are_the_same_for_all() -> None:
    starts = set()
    for method in METHODS:
        run = planned_run(method, "same", FERN, 0, PLUGINS)
        initializer = run.pipeline.one("initializer")
        settings = initializer.settings.model_dump(exclude={"prior", "hand_on_depth"})
        wanted = initializer.settings.model_dump()["prior"]
        (prior,) = [one for one in run.pipeline.items["priors"] if one.name == wanted]
        starts.add((initializer.host.use, prior.host.use, str(settings), str(prior.settings)))
        assert run.pipeline.protocol is not None
    assert len(starts) == 1


def test_the_digest_does_not_depend_on_the_location_of_the_data(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    here = planned_run(BASELINE, "own", FERN, 0, PLUGINS)
    monkeypatch.setenv("STEREOGS_DATA", "elsewhere")
    there = planned_run(BASELINE, "own", FERN, 0, PLUGINS)
    assert here.pipeline.to_yaml() != there.pipeline.to_yaml()
    assert here.digest == there.digest
    assert planned_run(BASELINE, "own", FERN, 1, PLUGINS).digest != here.digest


def test_the_page_shows_means_spreads_and_the_papers_numbers() -> None:
    found = [record(BASELINE, case, 0, 16.0) for case in FACING.cases]
    found += [record(DROPGAUSSIAN, FERN, seed, 20.0 + seed) for seed in FACING.seeds]
    text = methods_page.tables(found, 279)
    base, ours = row_of(text, "3DGS"), row_of(text, "DropGaussian")
    assert base[1:8] == ["1 + 1", "16.00", "16.00", "16.00", NONE, "0.500", "0.250"]
    assert base[8:13] == ["0.125", "12,345", "68", NONE, "910"]
    assert base[13:] == ["16.02", "0.465", "0.378"]
    assert ours[1:6] == ["3 + 0", "21.00 ± 1.00", NONE, NONE, "+4.00"]
    assert ours[6:13] == ["0.500", "0.250", "0.125", "12,345", "68", "1.0", "910"]
    assert ours[13:] == ["20.76", "0.713", "0.200"]
    assert "## Own points" in text
    assert "## Same points" not in text
    assert "5 of 279" in text


def test_objects_have_one_published_metric_of_each_protocol() -> None:
    found = [
        record(method, case, 0, psnr, "same")
        for method, psnr in ((BASELINE, 15.0), (DROPGAUSSIAN, 17.5))
        for case in OBJECTS.cases
    ]
    text = methods_page.tables(found, 279)
    assert "## Same points around objects" in text
    heads, ours = row_of(text, "method"), row_of(text, "DropGaussian")
    assert heads[2:7] == ["dtu_scan24", "dtu_scan65", "blender_lego", "mean", "to 3DGS"]
    assert heads[-2:] == ["paper: dtu-3", "paper: blender-8"]
    assert ours[1:7] == ["1 + 1 + 1", "17.50", "17.50", "17.50", "17.50", "+2.50 ± 0.00"]
    assert ours[-2:] == [NONE, "24.42"]
    heads, _, base, ours = rows_of(methods_page.summary(found))
    assert sum("paper" in heading for heading in heads) == 3
    assert base[1:] == [NONE, NONE, "16.02", "15.00", "10.99", "15.00", "23.20", NONE]
    assert ours[1:] == [NONE, NONE, "20.76", "17.50", NONE, "17.50", "24.42", NONE]


def test_seconds_are_of_one_machine_and_ratios_of_each() -> None:
    """Two machines, of which one is three times as fast and trained the flower."""
    other, alone = METHODS[1:3]
    fast = {"device": {"name": "pthread-a processor"}, "processor_model": "family 26"}
    seconds: list[tuple[Any, Any, int, float, dict[str, Any]]] = [
        (BASELINE, FERN, 0, 60.0, {}),
        (BASELINE, FLOWER, 0, 20.0, fast),
        (other, FERN, 0, 110.0, {}),
        (other, FERN, 1, 130.0, {}),
        (other, FLOWER, 0, 160.0, fast),
        (alone, FLOWER, 1, 90.0, {}),
    ]
    found = [
        record(method, case, seed, 20.0, cpu_seconds=took, **machine)
        for method, case, seed, took, machine in seconds
    ]
    text = methods_page.tables(found, 279)
    heads = row_of(text, "method")
    assert heads[9:13] == ["Gaussians", "CPU s, a processor", "CPU / 3DGS", "MB"]
    times = {row[0]: row[10:12] for row in rows_of(text)}
    assert times[BASELINE.title] == ["60", NONE]
    assert times[other.title] == ["120", "4.0"]  # twice on fern, eight times on flower
    assert times[alone.title] == ["90", NONE]  # 3DGS was not trained on flower there
