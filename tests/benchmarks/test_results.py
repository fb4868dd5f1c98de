"""The results campaign: its plan, and the tables and picture of real trainings."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import pytest
from PIL import Image
from rich.console import Console

from benchmarks import campaigns, error_report, priors, skips, trainings, where_seconds_go
from benchmarks.campaign import Campaign, one_by_one
from benchmarks.pages import DOCS, marks, rewrite
from benchmarks.results_page import Record, summary, tables
from benchmarks.results_picture import PICTURE, draw_first_views
from benchmarks.results_plan import (
    CASES,
    LPIPS,
    LPIPS_SEED,
    METHODS,
    SEEDS,
    Case,
    Measurement,
    Method,
    make_measurements,
)
from benchmarks.training_records import RECORDS, read, save
from registry import RunError
from tests.host import Plugins, locked

ROOM = Case(
    "room", 3, "", ("scene={use: procedural, width: 48, height: 36, test_views: 2, points: 100}",)
)
SEED = LPIPS_SEED + 1
MARKS = BEGIN, END = marks("results")
TINY = """\
name: {name}
scene: procedural
initializer: {initializer}
metrics: [psnr, ssim]
training: {{iterations: 4, sh_degree: 0}}
"""


def test_every_data_set_is_planned_by_its_protocol(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STEREOGS_DATA", "data")
    monkeypatch.setenv("STEREOGS_MODELS", "models")
    planned = make_measurements(CASES, METHODS, SEEDS, Plugins())
    assert [m.seed for m in planned] == sorted(m.seed for m in planned)
    views = {"llff_fern": (3, 6, 9), "llff_flower": (3, 6, 9), "blender_lego": (8,)}
    views |= {"llff_fortress": (3, 6, 9), "llff_room": (3, 6, 9), "dtu_scan114": (3, 6, 9)}
    views |= {"dtu_scan24": (3, 6, 9), "dtu_scan65": (3, 6, 9), "mip360_bonsai": (12, 24)}
    views |= {"mview_temple": (9, 20), "colmap_lightfield9": (7,)}
    expected = {(data, count) for data, counts in views.items() for count in counts}
    for method in METHODS:
        own = [m for m in planned if m.method is method and m.seed == SEED]
        assert {(m.case.data, m.case.views) for m in own} == expected
        assert len(own) == len(expected)
    for measurement in planned:
        pipeline = measurement.pipeline
        (scene,) = pipeline.items["scene"]
        if measurement.case.protocol:
            assert pipeline.protocol is not None
            assert pipeline.protocol.protocol.name == measurement.case.protocol
            assert pipeline.protocol.protocol.train_views == measurement.case.views
            only_bonsai = ["scene.images"] if measurement.case.data == "mip360_bonsai" else []
            assert list(pipeline.protocol.modified) == only_bonsai
        else:
            assert scene.settings.model_dump()["train_views"] == measurement.case.views
        assert Path(scene.settings.model_dump()["path"]) == Path("data", measurement.case.data)
        metrics = {item.name for item in pipeline.items["metrics"]}
        assert (LPIPS in metrics - set(measurement.without)) == (measurement.seed == LPIPS_SEED)
    assert len({m.digest for m in planned}) == len({m.name for m in planned}) == len(planned)
    # If this fails, train the changed pipelines again, or rewrite the digests of records whose
    # settings did not change.
    recorded = RECORDS / "results.jsonl"
    count = len(recorded.read_text("utf-8").splitlines())
    assert len(read(planned, recorded)) == count


@pytest.mark.parametrize(
    ("present", "message"),
    [(None, "STEREOGS_DATA is not set"), ("llff_fern", "STEREOGS_DATA lacks llff_flower")],
)
def test_missing_data_is_reported_before_training(
    present: str | None, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("STEREOGS_DATA", raising=False)
    if present:
        (tmp_path / present).mkdir()
        monkeypatch.setenv("STEREOGS_DATA", str(tmp_path))
    monkeypatch.setattr(sys, "argv", ["results"])
    with pytest.raises(SystemExit, match=message):
        campaigns.RESULTS.main(None)


def train(planned: list[Measurement], place: Path) -> dict[str, str]:
    return trainings.train(
        one_by_one(planned),
        jobs=2,
        seconds=None,
        device=None,
        out=place / "out",
        kept=place / "records.jsonl",
        console=Console(file=io.StringIO()),
    )


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Record], Path]:
    """Two real pipelines, trained on the procedural room, and the folder of their pictures."""
    place = tmp_path_factory.mktemp("results")
    methods = []
    for name, initializer in (("plain", "random"), ("better", "sfm")):
        file = place / f"{name}.yaml"
        file.write_text(TINY.format(name=name, initializer=initializer))
        methods.append(Method(name, file, baseline=name == "plain"))
    planned = make_measurements([ROOM], methods, [SEED], Plugins())
    assert train(planned, place) == {}
    return read(planned, place / "records.jsonl"), place / "out"


def row_of(text: str, first: str) -> list[str]:
    line = next(line for line in text.splitlines() if line.startswith(f"| {first} |"))
    return [cell.strip() for cell in line.strip("|").split("|")]


def test_the_page_shows_the_numbers_of_the_runs(measured: tuple[list[Record], Path]) -> None:
    records, _ = measured
    plain, better = records
    text = tables(records, 5)
    colours, rest = text.split("## Perceptual scores")
    psnr = [f"{record.scores['psnr']:.2f}" for record in records]
    gain = f"{better.scores['psnr'] - plain.scores['psnr']:+.2f}"
    ssim = [f"{record.scores['ssim']:.3f}" for record in records]
    assert row_of(colours, "room")[1:] == ["3", "1", *psnr, gain, *ssim]
    costs = [f"{record.measured[name]:,.0f}" for name in _COSTS for record in records]
    assert row_of(rest, "room")[1:] == ["3", "1", *["\u2013"] * 4, *costs]
    assert "initial points by `random`" in text
    assert "initial points by `sfm`" in text
    assert "at 48x36, 2 test views" in text


_COSTS = ("gaussians", "cpu_seconds", "peak_memory_mb")


def test_the_picture_shows_photographs_and_present_renders(
    measured: tuple[list[Record], Path], tmp_path: Path
) -> None:
    records, out = measured
    draw_first_views(records, out)
    assert (out / PICTURE).stat().st_size <= 400_000
    with Image.open(out / PICTURE) as sheet:
        assert sheet.format == "JPEG"
        assert sheet.width > 3 * 48
    draw_first_views(records, tmp_path)
    assert not (tmp_path / PICTURE).exists()


def test_data_sets_of_one_protocol_and_several_seeds_are_averaged(
    measured: tuple[list[Record], Path],
) -> None:
    plain, better = measured[0]

    def moved(record: Record, case: Case, seed: int, psnr: float) -> Record:
        run = record.run
        other = Measurement(case, run.method, seed, run.pipeline, run.digest)
        return Record(other, record.measured | {"scores": {"psnr": psnr, "ssim": 0.5}})

    room, den = Case("room", 3, "house-3", ()), Case("den", 3, "house-3", ())
    records = [moved(plain, room, seed, 10) for seed in SEEDS]
    records += [moved(better, room, seed, 12 + seed) for seed in SEEDS]
    records += [moved(better, den, 0, 21)]
    text = tables(records, 5)
    # Differences 2, 3, 4: Student's t for two degrees of freedom, 4.303, times 1 / sqrt(3).
    assert row_of(text, "room")[1:6] == ["3", "3", "10.00 ± 0.00", "13.00 ± 1.00", "+3.00 ± 2.48"]
    mean = row_of(text, "**mean of house-3**")
    assert mean[3:6] == ["**\u2013**", "**17.00**", "**+3.00 ± 2.48**"]
    assert row_of(summary(records), "house-3")[1:3] == ["\u2013", "17.00"]


def test_text_outside_the_marks_is_kept(tmp_path: Path) -> None:
    page = tmp_path / "results.md"
    page.write_text(f"# Ours\n\nWhy.\n\n{BEGIN}\nold numbers\n{END}\n\nWhat we saw.\n", "utf-8")
    rewrite(page, MARKS, "new numbers")
    text = page.read_text("utf-8")
    assert text == f"# Ours\n\nWhy.\n\n{BEGIN}\n\nnew numbers\n{END}\n\nWhat we saw.\n"
    page.write_text("# No marks\n", "utf-8")
    with pytest.raises(RunError, match="lacks the marks"):
        rewrite(page, MARKS, "new numbers")
    assert page.read_text("utf-8") == "# No marks\n"


def test_a_failed_run_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "broken.yaml"
    broken = "{use: ply, path: missing.ply}"
    file.write_text(TINY.format(name="broken", initializer=broken))
    planned = make_measurements([ROOM], [Method("broken", file)], [SEED], Plugins())
    monkeypatch.setattr("benchmarks.campaign.OUT", tmp_path / "out")
    monkeypatch.setattr("benchmarks.training_records.RECORDS", tmp_path / "records")
    monkeypatch.setenv("STEREOGS_DATA", str(tmp_path))
    monkeypatch.setattr(sys, "argv", ["tiny"])
    campaign = Campaign("tiny", "Tiny", [], lambda _: planned, "x.md", summary, tables)
    with pytest.raises(SystemExit, match=r"1 runs failed(.|\n)*missing\.ply"):
        campaign.main(None)
    assert "1 runs, 1 to train" in capsys.readouterr().out


PAGES = {one.name: DOCS / one.page for one in campaigns.CAMPAIGNS.values()}
PAGES |= {module.TARGET: module.PAGE for module in (error_report, priors, skips, where_seconds_go)}


@pytest.mark.parametrize("target", PAGES)
def test_a_page_has_its_marks(target: str) -> None:
    text = PAGES[target].read_text("utf-8")
    begin, end = marks(target)
    assert text.count(begin) == text.count(end) == 1
    assert text.index(begin) < text.index(end)


def test_write_docs_writes_all_tables_and_the_summary(
    measured: tuple[list[Record], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found, _ = measured
    kept, page = tmp_path / "results.jsonl", tmp_path / "x.md"
    for record in found:
        identity = record.run.identity
        save(record.run, {k: v for k, v in record.measured.items() if k not in identity}, kept)
    page.write_text(f"# Page\n\n{BEGIN}\n{END}\n", "utf-8")
    monkeypatch.setattr("benchmarks.campaign.OUT", tmp_path / "out")
    monkeypatch.setattr("benchmarks.campaign.DOCS", tmp_path)
    monkeypatch.setattr("benchmarks.pages.TABLES", tmp_path / "tables")
    monkeypatch.setattr("benchmarks.training_records.RECORDS", tmp_path)
    monkeypatch.setenv("STEREOGS_DATA", str(tmp_path))
    monkeypatch.setattr(sys, "argv", ["results", "--write-docs"])
    runs = [record.run for record in found]
    campaign = Campaign("results", "All", [], lambda _: runs, "x.md", summary, tables)
    assert campaign.main(None) == 0
    assert page.read_text("utf-8") == f"# Page\n\n{BEGIN}\n\n{summary(found)}\n{END}\n"
    assert (tmp_path / "tables" / "results.md").read_text("utf-8").endswith(tables(found, 2))


def test_a_second_command_is_kept_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmarks.campaign.OUT", tmp_path)
    monkeypatch.setattr(sys, "argv", ["tiny"])
    campaign = Campaign("tiny", "Tiny", [], lambda _: [], "x.md", summary, tables)
    (tmp_path / "tiny").mkdir()
    with locked(tmp_path / "tiny"), pytest.raises(SystemExit, match="in use by another process"):
        campaign.main(None)
