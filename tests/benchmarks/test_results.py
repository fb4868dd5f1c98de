"""The results campaign: its plan, and the tables and picture of real trainings; what all campaigns do."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest
from PIL import Image

from benchmarks import campaign, campaigns, next_views_page, records
from benchmarks.campaign import Campaign
from benchmarks.pages import DOCS, marks, rewrite
from benchmarks.records import RECORDS, Record, read, save
from benchmarks.results_page import summary, tables
from benchmarks.results_picture import PICTURE, draw_first_views
from benchmarks.results_plan import CASES, LPIPS_SEED, METHODS, planned_runs
from benchmarks.trainings import SEEDS, VGG, Case, Method, Training
from registry import RunError
from tests.benchmarks.made import ROOM, measure_here, row_of, tiny
from tests.host import Plugins, locked

SEED = LPIPS_SEED + 1
Records = list[Record[Training]]


def test_every_data_set_is_planned_by_its_protocol() -> None:
    planned = planned_runs(CASES, METHODS, SEEDS, Plugins())
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
        assert (VGG in metrics - set(measurement.without)) == (measurement.seed == LPIPS_SEED)
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


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> tuple[Records, Path]:
    """Two real pipelines, trained on the procedural room, and the folder of their pictures."""
    place = tmp_path_factory.mktemp("results")
    methods = [
        Method(name, tiny(place, name, start, "[psnr, ssim]"), baseline=name == "plain")
        for name, start in (("plain", "random"), ("better", "sfm"))
    ]
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("STEREOGS_PLUGINS", raising=False)
        runs = planned_runs([ROOM], methods, [SEED], Plugins())
        return measure_here(runs, place), place / "out"


def test_the_page_shows_the_numbers_of_the_runs(measured: tuple[Records, Path]) -> None:
    found, _ = measured
    plain, better = found
    text = tables(found, 5)
    colours, rest = text.split("## Perceptual scores")
    psnr = [f"{record.scores['psnr']:.2f}" for record in found]
    gain = f"{better.scores['psnr'] - plain.scores['psnr']:+.2f}"
    ssim = [f"{record.scores['ssim']:.3f}" for record in found]
    assert row_of(colours, "room")[1:] == ["3", "1", *psnr, gain, *ssim]
    names = ("gaussians", "cpu_seconds", "peak_memory_mb")
    costs = [f"{record.measured[name]:,.0f}" for name in names for record in found]
    assert row_of(rest, "room")[1:] == ["3", "1", *["\u2013"] * 4, *costs]
    assert "initial points by `random`" in text
    assert "initial points by `sfm`" in text
    assert "at 48x36, 2 test views" in text


def test_the_picture_shows_photographs_and_present_renders(
    measured: tuple[Records, Path], tmp_path: Path
) -> None:
    found, out = measured
    draw_first_views(found, out)
    assert (out / PICTURE).stat().st_size <= 400_000
    with Image.open(out / PICTURE) as sheet:
        assert sheet.format == "JPEG"
        assert sheet.width > 3 * 48
    draw_first_views(found, tmp_path)
    assert not (tmp_path / PICTURE).exists()


def test_data_sets_of_one_protocol_and_several_seeds_are_averaged(
    measured: tuple[Records, Path],
) -> None:
    plain, better = measured[0]

    def moved(record: Record[Training], case: Case, seed: int, psnr: float) -> Record[Training]:
        run = replace(record.run, case=case, seed=seed)
        return Record(run, record.measured | {"scores": {"psnr": psnr, "ssim": 0.5}})

    room, den = Case("room", 3, "house-3", ()), Case("den", 3, "house-3", ())
    found = [moved(plain, room, seed, 10) for seed in SEEDS]
    found += [moved(better, room, seed, 12 + seed) for seed in SEEDS]
    found += [moved(better, den, 0, 21)]
    text = tables(found, 5)
    # Differences 2, 3, 4: Student's t for two degrees of freedom, 4.303, times 1 / sqrt(3).
    averaged = text.split("## Perceptual scores")[0]
    assert row_of(averaged, "room")[1:6] == [
        "3",
        "3",
        "10.00 ± 0.00",
        "13.00 ± 1.00",
        "+3.00 ± 2.48",
    ]
    mean = row_of(averaged, "**mean of house-3**")
    assert mean[3:6] == ["**\u2013**", "**17.00**", "**+3.00 ± 2.48**"]
    assert row_of(summary(found), "house-3")[1:3] == ["\u2013", "17.00"]


def test_text_outside_the_marks_is_kept(tmp_path: Path) -> None:
    page, (begin, end) = tmp_path / "results.md", marks("results")
    page.write_text(f"# Ours\n\nWhy.\n\n{begin}\nold numbers\n{end}\n\nWhat we saw.\n", "utf-8")
    rewrite(page, marks("results"), "new numbers")
    text = page.read_text("utf-8")
    assert text == f"# Ours\n\nWhy.\n\n{begin}\n\nnew numbers\n{end}\n\nWhat we saw.\n"
    page.write_text("# No marks\n", "utf-8")
    with pytest.raises(RunError, match="lacks the marks"):
        rewrite(page, marks("results"), "new numbers")
    assert page.read_text("utf-8") == "# No marks\n"


PAGES = {c.target or c.name: DOCS / c.page for c in campaigns.CAMPAIGNS.values() if c.page}
PAGES |= {next_views_page.TARGET: next_views_page.PAGE}


@pytest.mark.parametrize("target", PAGES)
def test_a_page_has_its_marks(target: str) -> None:
    text = PAGES[target].read_text("utf-8")
    begin, end = marks(target)
    assert text.count(begin) == text.count(end) == 1
    assert text.index(begin) < text.index(end)


def campaign_of(
    runs: list[Training], place: Path, monkeypatch: pytest.MonkeyPatch, *options: str
) -> Campaign[Training]:
    """Return a campaign whose command has these options and writes into a folder."""
    monkeypatch.setattr(campaign, "OUT", place / "out")
    monkeypatch.setattr(campaign, "DOCS", place)
    monkeypatch.setattr("benchmarks.pages.TABLES", place / "tables")
    monkeypatch.setattr(records, "RECORDS", place / "records")
    monkeypatch.setenv("STEREOGS_DATA", str(place))
    monkeypatch.setattr(sys, "argv", ["results", *options])
    return Campaign("results", "All", [], lambda _: runs, tables, "x.md", summary)


def test_a_failed_run_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    broken = Method("broken", tiny(tmp_path, "broken", "{use: ply, path: missing.ply}"))
    made = campaign_of(planned_runs([ROOM], [broken], [SEED], Plugins()), tmp_path, monkeypatch)
    with pytest.raises(SystemExit, match=r"1 runs failed(.|\n)*missing\.ply"):
        made.main(None)
    assert "1 runs, 1 to train" in capsys.readouterr().out


def test_write_docs_writes_all_tables_and_the_summary(
    measured: tuple[Records, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found, _ = measured
    runs, page, (begin, end) = [record.run for record in found], tmp_path / "x.md", marks("results")
    page.write_text(f"# Page\n\n{begin}\n{end}\n", "utf-8")
    made = campaign_of(runs, tmp_path, monkeypatch, "--write-docs")
    for record in found:
        save(record.run, record.measured, tmp_path / "records" / "results.jsonl")
    assert made.main(None) == 0
    assert page.read_text("utf-8") == f"# Page\n\n{begin}\n\n{summary(found)}\n{end}\n"
    assert (tmp_path / "tables" / "results.md").read_text("utf-8").endswith(tables(found, 2))


def test_a_second_command_is_kept_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made, folder = campaign_of([], tmp_path, monkeypatch), tmp_path / "out" / "results"
    folder.mkdir(parents=True)
    with locked(folder), pytest.raises(SystemExit, match="in use by another process"):
        made.main(None)
