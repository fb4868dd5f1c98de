"""The results table: what is planned, what is trained once, and the page that real runs end in."""

from __future__ import annotations

import io
import json
import sys
from pathlib import Path

import pytest
from PIL import Image
from rich.console import Console

from benchmarks import results
from benchmarks.results_page import BEGIN, END, Record, draw_first_views, page_text, write_page
from benchmarks.results_plan import CASES, METHODS, Case, Measurement, Method, make_measurements
from registry import RunError
from registry.ablation.running.folder import AblationFolder
from registry.plugins.discovery import Plugins

ROOM = Case(
    "room", 3, ("scene={use: procedural, width: 48, height: 36, test_views: 2, points: 100}",)
)
TINY = """\
name: {name}
scene: procedural
initializer: {initializer}
metrics: [psnr, ssim]
training: {{iterations: 4, sh_degree: 0}}
"""


def test_every_data_set_is_planned_by_its_protocol(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STEREOGS_DATA", "data")
    planned = make_measurements(CASES, METHODS, Plugins())
    views = {"llff_fern": (3, 6, 9), "llff_flower": (3, 6, 9), "blender_lego": (8,)}
    views |= {"dtu_scan24": (3, 6, 9), "dtu_scan65": (3, 6, 9), "mip360_bonsai": (12, 24)}
    expected = {(data, count) for data, counts in views.items() for count in counts}
    for method in METHODS:
        own = [m for m in planned if m.method is method]
        assert {(m.case.data, m.case.views) for m in own} == expected
        assert len(own) == len(expected)
    for measurement in planned:
        pipeline = measurement.run.pipeline
        assert pipeline.protocol is not None
        (scene,) = pipeline.items["scene"]
        assert pipeline.protocol.protocol.train_views == measurement.case.views
        assert Path(scene.settings.model_dump()["path"]) == Path("data", measurement.case.data)
        only_bonsai = ["scene.images"] if measurement.case.data == "mip360_bonsai" else []
        assert list(pipeline.protocol.modified) == only_bonsai
    assert len({m.run.digest for m in planned}) == len(planned)


def test_a_trial_is_as_short_as_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STEREOGS_DATA", "data")
    planned = make_measurements(CASES, METHODS, Plugins(), 30)
    assert {m.run.pipeline.training.iterations for m in planned} == {30}


@pytest.mark.parametrize(
    ("present", "said"),
    [(None, "STEREOGS_DATA is not set"), ("llff_fern", "STEREOGS_DATA lacks llff_flower")],
)
def test_missing_data_is_said_before_anything_is_trained(
    present: str | None, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("STEREOGS_DATA", raising=False)
    if present:
        (tmp_path / present).mkdir()
        monkeypatch.setenv("STEREOGS_DATA", str(tmp_path))
    out = tmp_path / "out"
    monkeypatch.setattr(sys, "argv", ["results", "--out", str(out)])
    with pytest.raises(SystemExit, match=said):
        results.main()
    assert not out.exists()


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Measurement], AblationFolder]:
    """Two real pipelines, trained on the procedural room."""
    place = tmp_path_factory.mktemp("results")
    methods = []
    for name, initializer in (("plain", "random"), ("better", "sfm")):
        file = place / f"{name}.yaml"
        file.write_text(TINY.format(name=name, initializer=initializer))
        methods.append(Method(name, file))
    planned = make_measurements([ROOM], methods, Plugins())
    folder = AblationFolder(place / "out")
    train(planned, folder)
    return planned, folder


def train(planned: list[Measurement], folder: AblationFolder) -> tuple[list[Record], str]:
    printed = io.StringIO()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("STEREOGS_CACHE", "")
        records = results.measure(planned, folder, None, Console(file=printed))
    assert records is not None
    return records, printed.getvalue()


def test_finished_runs_are_read_and_not_trained_again(
    measured: tuple[list[Measurement], AblationFolder],
) -> None:
    planned, folder = measured
    before = [(folder.run(m.run).path / "results.json").stat().st_mtime_ns for m in planned]
    records, printed = train(planned, folder)
    assert "2 runs, 0 to train" in printed
    after = [(folder.run(m.run).path / "results.json").stat().st_mtime_ns for m in planned]
    assert after == before
    for record, measurement in zip(records, planned, strict=True):
        path = folder.run(measurement.run).path / "results.json"
        found = json.loads(path.read_text("utf-8"))
        assert record.numbers["PSNR"] == found["test"]["psnr"]
        assert record.numbers["seconds"] == found["seconds"] + found["initialization"]["seconds"]


def test_the_page_shows_the_numbers_of_the_runs(
    measured: tuple[list[Measurement], AblationFolder], tmp_path: Path
) -> None:
    records, _ = train(*measured)
    page, picture = tmp_path / "results.md", tmp_path / "results.jpg"
    write_page(records, page)
    draw_first_views(records, picture)
    text = page.read_text("utf-8")
    (row,) = [line for line in text.splitlines() if line.startswith("| room | 3 |")]
    cells = [cell.strip() for cell in row.strip("|").split("|")]
    psnr = [f"{record.run.results['test']['psnr']:.2f}" for record in records]
    ssim = [f"{record.run.results['test']['ssim']:.3f}" for record in records]
    assert cells[2:6] == psnr + ssim
    assert "initial points by `random`" in text
    assert "initial points by `sfm`" in text
    assert "at 48x36, 2 test views" in text
    assert picture.stat().st_size <= 400_000
    with Image.open(picture) as sheet:
        assert sheet.format == "JPEG"
        assert sheet.width > 3 * 48


def test_data_sets_of_one_protocol_are_averaged(
    measured: tuple[list[Measurement], AblationFolder],
) -> None:
    (first, second), _ = train(*measured)
    alike = Record(Case("den", 3, ()), first.method, second.run)
    text = page_text([first, alike])
    mean = (first.numbers["PSNR"] + second.numbers["PSNR"]) / 2
    assert f"| **mean of procedural** | 3 | **{mean:.2f}** |" in text
    assert "**mean" not in page_text([first]).split("Each column")[0]


def test_what_people_wrote_on_the_page_stays(
    measured: tuple[list[Measurement], AblationFolder], tmp_path: Path
) -> None:
    records, _ = train(*measured)
    page = tmp_path / "results.md"
    page.write_text(f"# Ours\n\nWhy.\n\n{BEGIN}\nold numbers\n{END}\n\nWhat we saw.\n", "utf-8")
    write_page(records, page)
    text = page.read_text("utf-8")
    assert text == f"# Ours\n\nWhy.\n\n{BEGIN}\n\n{page_text(records)}\n{END}\n\nWhat we saw.\n"
    page.write_text("# No marks\n", "utf-8")
    with pytest.raises(RunError, match="lost the marks"):
        write_page(records, page)
    assert page.read_text("utf-8") == "# No marks\n"


def test_a_failed_run_is_told(tmp_path: Path) -> None:
    file = tmp_path / "broken.yaml"
    broken = "{use: ply, path: missing.ply}"
    file.write_text(TINY.format(name="broken", initializer=broken))
    planned = make_measurements([ROOM], [Method("broken", file)], Plugins())
    with pytest.raises(RunError, match=r"1 of 1 runs failed(.|\n)*missing\.ply"):
        train(planned, AblationFolder(tmp_path / "out"))
