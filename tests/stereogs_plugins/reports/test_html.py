from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
import torch

from core_rasterizer import Rendering
from registry import RunError
from registry.drawing.pictures import save_png, save_view_pictures
from registry.runs.folder import RunFolder
from registry.testing import tiny_scene
from stereogs_plugins.reports.html import HtmlReport, stereogs_register_reports
from tests.html_page import Page
from tests.stereogs_plugins.building import build, offered

RESULTS: dict[str, Any] = {
    "pipeline": "3dgs <fast>",
    "scene": {"name": "tiny", "train": ["view0"], "extent": 0.22},
    "gaussians": 12345,
    "seconds": 7.5,
    "peak_memory_mb": None,
    "test": {"psnr": 20.0, "lpips": None},
    "train": {"psnr": None, "lpips": None},
    "views": {
        "test": {"view1": {"psnr": 20.0, "lpips": None}},
        "train": {"view0": {"psnr": None, "lpips": None}},
    },
    "unavailable": {"lpips": "there is no model & no file"},
}


def texts(page: str, tag: str) -> list[str]:
    return re.findall(rf"<{tag}>(.*?)</{tag}>", page)


@pytest.fixture
def run(tmp_path: Path) -> RunFolder:
    """A run's folder, written by the host itself."""
    run = RunFolder(tmp_path / "run")
    run.create(
        "name: 3dgs  # <b>\n",
        {"command": ["stereogs", "train"], "seed": 3},
        {},
        lambda folder: None,
    )
    scene = tiny_scene()
    picture = torch.full((24, 32, 3), 0.5)
    run.write_initialization({"points": 60, "views": {"view0": 0.5}}, {"depth of view0": picture})
    rendering = Rendering(picture, torch.ones(24, 32), torch.ones(24, 32))
    save_view_pictures(rendering, scene.test[0], run.folder("renders"))
    for iteration in (50, 100):
        run.append_metrics({"iteration": iteration, "seconds": 1.0, "loss": 9 / iteration})
        run.append_metrics({"iteration": iteration, "test": {"psnr": iteration / 5, "x": None}})
    run.write_results(RESULTS)
    return run


def written(run: RunFolder) -> str:
    (file,) = build(HtmlReport).write(run.path, tiny_scene())
    assert file == run.path / "report.html"
    assert not list(run.path.glob("*.partial"))
    return file.read_text("utf-8")


def test_is_offered_as_html() -> None:
    assert offered(stereogs_register_reports) == {"html": HtmlReport}


def test_the_page_holds_everything_and_loads_nothing(run: RunFolder) -> None:
    page = written(run)
    tags = Page(page)
    assert "script" not in tags.tags
    assert len(tags.loads) == 2
    assert all(source.startswith("data:image/jpeg;base64,") for source in tags.loads)
    assert texts(page, "h2") == [
        "Scores",
        "Test views: photograph, render, depth",
        "Training",
        "Initialization",
        "Pipeline",
        "Scene",
        "Provenance",
    ]
    for text in ("12,345", "7.5", "view1, psnr 20.00, lpips \u2013", "stereogs, train", "depth of"):
        assert text in page


def test_pictures_are_those_of_the_run(run: RunFolder) -> None:
    view, initial = Page(written(run)).pictures()
    assert view.size == (3 * 32 + 2 * 4, 24)  # photograph, render and depth, with gaps
    assert initial.size == (32, 24)
    assert initial.getpixel((5, 5)) == pytest.approx((128, 128, 128), abs=2)


def test_scores_of_every_view_and_why_one_is_missing(run: RunFolder) -> None:
    page = written(run)
    table = page[page.index("<thead>") : page.index("</tbody>")]
    cells = [
        re.findall(r"<t[dh][^>]*>(.*?)</t[dh]>", row) for row in re.findall(r"<tr.*?</tr>", table)
    ]
    assert cells == [
        ["view", "psnr", "lpips"],
        ["test view1", "20.00", "\u2013"],
        ["test mean", "20.00", "\u2013"],
        ["train view0", "\u221e", "\u2013"],
        ["train mean", "\u221e", "\u2013"],
    ]
    assert "lpips is not available: there is no model &amp; no file" in page


def test_what_training_logged_is_plotted(run: RunFolder) -> None:
    run.append_metrics({"iteration": 100, "opacity_beta_q05": 0.1, "opacity_beta_q95": 2.0})
    run.append_metrics({"iteration": 100, "s_valid": 0.5, "s_occluded": 0.4, "own": 3, "n": None})
    page = written(run)
    plots = re.findall(r'<figure class="plot"><figcaption>(.*?)</figcaption>', page)
    assert plots == [
        "Loss",
        "Test: psnr",
        "The same over its mean: quantiles, %",
        "Stereo: share of pixels",
        "own",
    ]


def test_text_from_files_cannot_become_markup(run: RunFolder) -> None:
    page = written(run)
    assert "<title>tiny: 3dgs &lt;fast&gt;</title>" in page
    assert "<pre>name: 3dgs  # &lt;b&gt;" in page
    assert "3dgs <fast>" in Page(page).text


def test_a_large_picture_is_reduced(run: RunFolder) -> None:
    save_png(torch.rand(40, 4000, 3), run.path / "initialization" / "wide.png")
    widths = [picture.width for picture in Page(written(run)).pictures()]
    assert sorted(widths) == [32, 104, 1560]


def test_a_scored_run_without_anything_else_has_a_page(tmp_path: Path) -> None:
    (tmp_path / "results.json").write_text(json.dumps(RESULTS), "utf-8")
    page = written(RunFolder(tmp_path))
    assert texts(page, "h2") == ["Scores", "Scene"]


def test_an_unfinished_run_and_damaged_files_are_explained(run: RunFolder) -> None:
    with (run.path / "metrics.jsonl").open("a") as file:
        file.write('{"iteration": 2')
    with pytest.raises(RunError, match="not JSON") as caught:
        written(run)
    assert caught.value.where == f"{run.path / 'metrics.jsonl'}:5"
    (run.path / "results.json").write_text("[1]")
    with pytest.raises(RunError, match="should be an object"):
        written(run)
    (run.path / "results.json").unlink()
    with pytest.raises(RunError, match=r"no results\.json") as caught:
        written(run)
    assert "stereogs resume" in caught.value.fix
