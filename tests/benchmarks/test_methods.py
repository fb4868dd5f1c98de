"""The methods campaign: its plan, the record of a training, and the tables."""

from __future__ import annotations

import io
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml
from rich.console import Console

from benchmarks import methods_page, training_process, training_records, trainings
from benchmarks.cells import NONE
from benchmarks.methods_plan import (
    AUTHORS_SETTINGS,
    BASELINE,
    GROUPS,
    METHODS,
    NETWORKED,
    Method,
    MethodRun,
    Points,
    planned_run,
    planned_runs,
)
from benchmarks.results_plan import Case
from benchmarks.training_records import Record
from registry import RunError
from stereogs import Pipeline, build_pipeline
from tests.host import Plugins

PLUGINS = Plugins()
FACING, OBJECTS = GROUPS
FERN, _ = FACING.cases
ROOM = Case("room", 3, "", ())
TINY = """\
name: tiny
scene: {{use: procedural, width: 48, height: 36, test_views: 2, points: 100}}
initializer: sfm
metrics: {metrics}
training: {{iterations: 4, sh_degree: 0}}
"""


@pytest.fixture(autouse=True)
def _folders(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STEREOGS_DATA", "data")
    monkeypatch.setenv("STEREOGS_MODELS", "models")


def tiny(place: Path, metrics: str = "[psnr, ssim]") -> Path:
    file = place / training_process.PIPELINE
    file.write_text(TINY.format(metrics=metrics), "utf-8")
    return file


def run_of(file: Path, seed: int = 0) -> MethodRun:
    return MethodRun(Method("Tiny", file), "own", ROOM, seed, build_pipeline(file), "0123456789")


def record(
    method: Method, case: Case, seed: int, psnr: float, points: Points = "own"
) -> Record[MethodRun]:
    run = MethodRun(method, points, case, seed, None, "")  # type: ignore[arg-type]
    measured: dict[str, Any] = {
        "scores": {"psnr": psnr, "ssim": 0.5, "lpips": 0.25, "avge": 0.125},
        "gaussians": 12_345,
        "cpu_seconds": 67.8,
        "peak_memory_mb": 910,
        "device": {"name": "a processor"},
    }
    return Record(run, measured)


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
    recorded = training_records.read(runs, training_records.RECORDS / "methods.jsonl")
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


def trained(run: MethodRun, place: Path, seconds: float | None) -> dict[str, str]:
    return trainings.train(
        [[run]],
        jobs=1,
        seconds=seconds,
        device=None,
        out=place / "out",
        kept=place / "records.jsonl",
        console=Console(file=io.StringIO()),
    )


def test_a_training_records_scores_costs_and_circumstances(tmp_path: Path) -> None:
    run = run_of(tiny(tmp_path))
    assert trained(run, tmp_path, None) == {}
    (record,) = training_records.read([run], tmp_path / "records.jsonl")
    found = record.measured
    assert set(record.scores) == {"psnr", "ssim"}
    assert len(found["views"]) == 2  # the test views, and no others
    assert found["gaussians"] == found["initial_points"] == 100
    assert found["points"] == "own"
    assert found["iterations"] == 4
    assert found["cpu_seconds"] > 0
    assert len(found["hash"]) == 64
    assert "processor_model" in found
    assert {"torch", "stereogs-plugins"} <= set(found["packages"])
    assert len(list((tmp_path / "out" / run.name / "renders").glob("*.png"))) == 2


def test_a_missing_score_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("STEREOGS_MODELS")
    monkeypatch.setattr(sys, "argv", ["", str(tiny(tmp_path, "[lpips]").parent)])
    with pytest.raises(SystemExit) as ended:
        training_process.main()
    message = trainings.failure(f"0.01 it/s\n{ended.value}\n")
    assert message.startswith("a score is missing")
    assert "set STEREOGS_MODELS" in message
    assert not (tmp_path / training_process.ANSWER).exists()


def test_an_unexplained_error_is_shown() -> None:
    assert trainings.failure("Traceback\nKeyError: 'x'\n") == "Traceback\nKeyError: 'x'"


def test_no_training_starts_after_the_time_limit(tmp_path: Path) -> None:
    assert trained(run_of(tiny(tmp_path)), tmp_path, 0) == {}
    assert not (tmp_path / "out").exists()


def test_a_record_of_another_pipeline_is_skipped(tmp_path: Path) -> None:
    run = run_of(tiny(tmp_path))
    file = tmp_path / "records.jsonl"
    training_records.save(run, {"scores": {"psnr": 20.0}}, file)
    assert [one.scores["psnr"] for one in training_records.read([run], file)] == [20.0]
    changed = MethodRun(run.method, "own", ROOM, 0, run.pipeline, "another")
    assert training_records.read([changed], file) == []
    file.write_text("[]", "utf-8")
    with pytest.raises(RunError, match="cannot be read"):
        training_records.read([run], file)


def test_the_page_shows_means_spreads_and_the_papers_numbers() -> None:
    dropgaussian = next(method for method in METHODS if method.paper == "dropgaussian")
    records = [record(BASELINE, case, 0, 16.0) for case in FACING.cases]
    records += [record(dropgaussian, FERN, seed, 20.0 + seed) for seed in FACING.seeds]
    text = methods_page.tables(records, 279)
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines()]
    (base,) = [row for row in rows if row and row[0] == "3DGS"]
    (ours,) = [row for row in rows if row and row[0] == "DropGaussian"]
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
    dropgaussian = next(method for method in METHODS if method.paper == "dropgaussian")
    records = [record(BASELINE, case, 0, 15.0, "same") for case in OBJECTS.cases]
    records += [record(dropgaussian, case, 0, 17.5, "same") for case in OBJECTS.cases]
    text = methods_page.tables(records, 279)
    assert "## Same points around objects" in text
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines()]
    (heads,) = [row for row in rows if row and row[0] == "method"]
    assert heads[2:7] == ["dtu_scan24", "dtu_scan65", "blender_lego", "mean", "to 3DGS"]
    assert heads[-2:] == ["paper: dtu-3", "paper: blender-8"]
    (ours,) = [row for row in rows if row and row[0] == "DropGaussian"]
    assert ours[1:7] == ["1 + 1 + 1", "17.50", "17.50", "17.50", "17.50", "+2.50 ± 0.00"]
    assert ours[-2:] == [NONE, "24.42"]
    heads, _, base, ours = methods_page.summary(records).splitlines()
    assert heads.count("paper") == 3
    assert base == (f"| 3DGS | {NONE} | {NONE} | 16.02 | 15.00 | 10.99 | 15.00 | 23.20 | {NONE} |")
    assert ours == (
        f"| DropGaussian | {NONE} | {NONE} | 20.76 | 17.50 | {NONE} | 17.50 | 24.42 | {NONE} |"
    )


def test_seconds_are_of_one_machine_and_ratios_of_each() -> None:
    """Two machines, of which one is three times as fast and trained the flower."""
    fast = {"device": {"name": "pthread-a processor"}, "processor_model": "family 26"}

    def timed(
        method: Method, case: Case, seed: int, seconds: float, **machine: object
    ) -> Record[MethodRun]:
        one = record(method, case, seed, 20.0)
        return replace(one, measured=one.measured | machine | {"cpu_seconds": seconds})

    fern, flower = FACING.cases
    other, alone = METHODS[1:3]
    records = [
        timed(BASELINE, fern, 0, 60),
        timed(BASELINE, flower, 0, 20, **fast),
        timed(other, fern, 0, 110),
        timed(other, fern, 1, 130),
        timed(other, flower, 0, 160, **fast),
        timed(alone, flower, 1, 90),
    ]
    text = methods_page.tables(records, 279)
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines()]
    (heads,) = [row for row in rows if row and row[0] == "method"]
    assert heads[9:13] == ["Gaussians", "CPU s, a processor", "CPU / 3DGS", "MB"]
    times = {row[0]: row[10:12] for row in rows if row}
    assert times[BASELINE.title] == ["60", NONE]
    assert times[other.title] == ["120", "4.0"]  # twice on fern, eight times on flower
    assert times[alone.title] == ["90", NONE]  # 3DGS was not trained on flower there
