from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from core_rasterizer import Gaussians, Rendering
from registry import Fact, RunError
from registry.testing import tiny_scene
from registry.toolkit.drawing import save_png
from stereogs_plugins.reports.html import HtmlReport, stereogs_register_reports
from tests.host import (
    CHECKPOINT,
    Checkpoint,
    RunFolder,
    save_checkpoint,
    save_view_pictures,
    write_json,
)
from tests.html_page import Page
from tests.stereogs_plugins.building import build, offered

RESULTS: dict[str, Any] = {
    "pipeline": "3dgs <fast>",
    "scene": {"name": "tiny", "train": ["view0"], "extent": 0.22},
    "iterations": 120,
    "gaussians": 12345,
    "seconds": 7.5,
    "peak_memory_mb": None,
    "test": {"psnr": 20.0, "lpips": None},
    "train": {"psnr": None, "lpips": None},
    "views": {
        "test": {"view1": {"psnr": 20.0, "lpips": None}},
        "train": {"view0": {"psnr": None, "lpips": None}},
    },
    "infinite": {"train": {"psnr": ["view0"]}},
    "unavailable": {"lpips": "there is no model & no file"},
}
COUNT = 50


def some_gaussians() -> Gaussians:
    random = torch.Generator().manual_seed(0)

    def numbers(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=random)

    return Gaussians(
        3 * numbers(COUNT, 3),
        numbers(COUNT, 3) - 3,
        numbers(COUNT, 4),
        numbers(COUNT),
        0.3 * numbers(COUNT, 4, 3),
    )


def texts(page: str, tag: str) -> list[str]:
    return re.findall(rf"<{tag}>(.*?)</{tag}>", page)


@pytest.fixture
def run(tmp_path: Path) -> RunFolder:
    """A run's folder, written by the host itself."""
    run = RunFolder(tmp_path / "run")
    origin = {
        "command": ["tools/bin/stereogs", "train", "a b"],
        "seed": 3,
        "started": "2026-05-04T03:02:01+00:00",
        "device": {"name": "a processor"},
        "source": {"commit": "c0ffee", "dirty": True},
    }
    run.create(
        "name: 3dgs  # <b>\ntraining: {dilation: 0.25}\n",
        origin,
        {},
        lambda folder: None,
    )
    scene = tiny_scene()
    picture = torch.full((24, 32, 3), 0.5)
    facts = {"points": 60, "points_by_kind": {"back_layer": 15, "filled": 45}, "x": {"y": 0.5}}
    facts["picture_columns"] = ["photograph", "depth <1>"]
    run.write_initialization(facts, {"depth of view0": picture})
    rendering = Rendering(picture, torch.linspace(2, 4, 768).view(24, 32), torch.ones(24, 32))
    save_view_pictures(rendering, scene.test[0], run.folder("renders"))
    for iteration in (50, 100):
        run.append_metrics({"iteration": iteration, "seconds": 1.0, "loss": 9 / iteration})
        run.append_metrics({"iteration": iteration, "test": {"psnr": iteration / 5, "x": None}})
    write_json(run.path / "results.json", RESULTS)
    return run


def add_checkpoint(run: RunFolder) -> None:
    model = {f"model/{name}": value for name, value in vars(some_gaussians()).items()}
    save_checkpoint(Checkpoint(120, 7.5, model, "name: 3dgs\n"), run.folder(CHECKPOINT))


def written(run: RunFolder, **settings: object) -> str:
    file = build(HtmlReport, **settings).write(run.path, tiny_scene())[0]
    assert file == run.path / "report.html"
    assert not list(run.path.glob("*.partial"))
    return file.read_text("utf-8")


def test_is_offered_as_html() -> None:
    assert offered(stereogs_register_reports) == {"html": HtmlReport}


def test_the_page_holds_everything_and_loads_nothing(run: RunFolder) -> None:
    add_checkpoint(run)
    page = written(run)
    tags = Page(page)
    assert len(tags.loads) == 5, "photograph, render, error, depth, initial depth"
    assert all(source.startswith("data:image/jpeg;base64,") for source in tags.loads)
    assert texts(page, "h2") == [
        "Held-out photographs and renders",
        "Numbers",
        "Training",
        "First points",
        "Photographs",
    ]
    assert page.index('class="scene-view"') < page.index("<h2>"), "the scene comes first"
    for text in ("12,345 Gaussians", "7.5", "view1, psnr 20.00, lpips \u2013", "depth of"):
        assert text in page
    for text in (
        "2026-05-04 03:02:01 UTC",
        "c0ffee with changes",
        "<td>stereogs train &#x27;a b&#x27;",
    ):
        assert text in page[page.index("<summary>Provenance") :]
    assert '<td class="name">held-out photographs (1)</td><td>20.00</td>' in page
    assert "Scores are of 1 photograph held out from training" in page


def test_pictures_of_a_view_are_its_photograph_render_error_and_depth(run: RunFolder) -> None:
    page = written(run)
    render, photograph, error, depth, initial = Page(page).pictures()
    assert {picture.size for picture in (photograph, render, error, depth, initial)} == {(32, 24)}
    assert render.getpixel((5, 5)) == pytest.approx((128, 128, 128), abs=2)
    view = tiny_scene().test[0]
    mean = float((view.image - 0.5).abs().mean())
    assert np.asarray(photograph).mean() / 255 == pytest.approx(float(view.image.mean()), abs=0.02)
    assert mean > 0.05
    assert np.asarray(error).std() > 5, "the error differs from place to place"
    assert "3.9" in page, "the depth of the farthest colour"
    with Image.open(run.path / "renders" / "depth" / f"{view.name}.png") as picture:
        assert picture.info["nearest depth"] == "2.04", "the 98th percentile of the inverse"


def test_the_error_shows_pixels_that_the_mask_excludes_in_grey(run: RunFolder) -> None:
    scene = tiny_scene()
    mask = torch.ones(24, 32, dtype=torch.bool)
    mask[:, :16] = False
    scene = replace(scene, test=(replace(scene.test[0], mask=mask), *scene.test[1:]))
    file = build(HtmlReport).write(run.path, scene)[0]
    error = np.asarray(Page(file.read_text("utf-8")).pictures()[2].convert("RGB"), float)
    assert np.ptp(error[:, :12], axis=2).max() < 12
    assert np.ptp(error[:, 20:], axis=2).min() > 12
    assert "grey: excluded by the mask" in file.read_text("utf-8")


def test_initial_points_are_told_by_kind(run: RunFolder) -> None:
    page = written(run)
    assert '<td class="name">back layer</td><td>15</td><td>25.0%</td>' in page
    columns = '<div class="headings"><span>photograph</span><span>depth &lt;1&gt;</span></div><img'
    assert columns in page
    assert "picture_columns" not in page


def test_without_held_out_photographs_the_page_shows_and_says_what_it_scores(
    run: RunFolder,
) -> None:
    scene = tiny_scene()
    everything = replace(scene, train=(*scene.train, *scene.test), test=())
    scores = {"train": {"psnr": 30.0}, "test": {}}
    rows = {"train": {"view1": {"psnr": 30.0}}, "test": {}}
    names = {"scene": {"name": "tiny", "train": ["view1"]}}
    rest = {"views": rows, "infinite": {}}
    write_json(run.path / "results.json", RESULTS | scores | names | rest)
    page = build(HtmlReport).write(run.path, everything)[0].read_text("utf-8")
    assert texts(page, "h2")[:2] == ["Training photographs and renders", "Numbers"]
    assert "view1, psnr 30.00" in page
    assert "they do not measure how well other views are rendered" in page
    assert "held-out photographs (" not in page


def test_facts_are_sentences(run: RunFolder) -> None:
    facts = (
        Fact("turned_upright", 2),
        Fact("lenses", 1),
        Fact("focal_lengths_by_exif", 0),
        Fact("other_files", 1, "left out: notes.txt, which is not a picture"),
        Fact("changed", "nothing"),
    )
    page = build(HtmlReport).write(run.path, replace(tiny_scene(), facts=facts))[0].read_text()
    words = page[page.index("<h2>Photographs") : page.index("<summary>Provenance")]
    for sentence in (
        "2 photographs turned upright by EXIF.",
        "All photographs have one lens.",
        "No photograph states its focal length; it was estimated.",
        "Other files: left out: notes.txt, which is not a picture.",
    ):
        assert sentence in words
    assert "_" not in words
    assert "nothing" not in words


def test_a_return_to_a_checkpoint_is_told(run: RunFolder) -> None:
    found = {"iteration": 81, "back_to": 64, "rates": 0.5, "error": "6 values are not finite"}
    write_json(run.path / "results.json", {**RESULTS, "recoveries": [found]})
    page = Page(written(run))
    assert "training went back to iteration 64 with learning rates times 0.5" in page.text


def test_an_edit_by_hand_is_told(run: RunFolder) -> None:
    found = {"folder": "fern", "gaussians": 5000, "removed": 1200, "by": "stereogs view"}
    edit = {**found, "run": "", "hash": "0" * 64}
    write_json(run.path / "results.json", {**RESULTS, "edits": [edit]})
    page = Page(written(run))
    assert "1,200 of 5,000 Gaussians of the run fern were removed by hand" in page.text


def test_scores_of_every_view_and_why_one_is_missing(run: RunFolder) -> None:
    page = written(run)
    table = page[page.index("<summary>scores of each photograph") :]
    table = table[table.index("<thead>") : table.index("</tbody>")]
    cells = [
        re.findall(r"<t[dh][^>]*>(.*?)</t[dh]>", row) for row in re.findall(r"<tr.*?</tr>", table)
    ]
    assert cells == [
        ["view", "kind", "psnr, dB", "lpips"],
        ["view1", "held-out photographs", "20.00", "\u2013"],
        ["view0", "training photographs", "\u221e", "\u2013"],
    ]
    assert "lpips is not available: there is no model &amp; no file" in page


def test_what_training_logged_is_plotted(run: RunFolder) -> None:
    for k in range(3):
        values = {"opacity_beta_q05": k / 10, "s_valid": k / 4, "own": k, "flat": 3, "n": None}
        run.append_metrics({"iteration": 102 + k, **values, "same": k})
        loss = {"loss": k / 9, "photometric": k / 9} if k else {}
        run.append_metrics({"iteration": 105 + k, **loss})
    run.append_metrics({"iteration": 110, "twice": 1})
    run.append_metrics({"iteration": 120, "twice": 2})
    page = written(run)
    plots = re.findall(r'<figure class="plot"><figcaption>(.*?)</figcaption>', page)
    assert plots == [
        "Loss",
        "Held-out photographs: psnr, dB",
        "Gradient of opacities over its mean: quantiles, %",
        "Stereo: share of pixels",
        "own",
    ], "neither constants, nor two points, nor the same curve twice"
    assert page.index("<summary>other logged values") < page.index("Stereo: share")
    scores = page[page.index('aria-label="Held-out photographs: psnr, dB"') :].split("</svg>")[0]
    assert scores.count("<circle") == 3, "two evaluations, and the end"
    assert ">50 (1 s)<" in scores


def test_text_from_files_cannot_become_markup(run: RunFolder) -> None:
    page = written(run)
    assert "<title>tiny: 3dgs &lt;fast&gt;</title>" in page
    assert "<pre>name: 3dgs  # &lt;b&gt;" in page
    assert "3dgs <fast>" in Page(page).text


def test_a_large_picture_is_reduced(run: RunFolder) -> None:
    save_png(torch.rand(40, 4000, 3), run.path / "initialization" / "wide.png")
    widths = [picture.width for picture in Page(written(run)).pictures()]
    assert sorted(widths) == [32, 32, 32, 32, 32, 1560]


def test_a_scored_run_without_anything_else_has_a_page(tmp_path: Path) -> None:
    (tmp_path / "results.json").write_text(json.dumps(RESULTS), "utf-8")
    page = written(RunFolder(tmp_path))
    assert texts(page, "h2") == ["Numbers", "Photographs"]


def test_the_gaussians_lie_in_the_page_or_beside_it_or_are_too_large(run: RunFolder) -> None:
    add_checkpoint(run)
    inside = written(run)
    assert 'id="scene-data"' in inside
    assert 'id="viewer-data"' in inside
    setup = json.loads(inside.split('id="scene-setup">')[1].split("</script>")[0])
    assert setup["dilation"] == 0.25
    assert len(setup["views"]) == len((*tiny_scene().test, *tiny_scene().train))
    report = build(HtmlReport, beside=True)
    page, viewer, data = report.write(run.path, tiny_scene())
    assert page.stat().st_size < 100_000 < viewer.stat().st_size
    assert data.read_text().startswith('globalThis["scene-data"]="')
    assert Page(page.read_text("utf-8")).loads[:2] == [
        "report_files/viewer.js",
        "report_files/scene.js",
    ]
    own = data.with_name("notes.txt")
    own.write_text("somebody's")
    small = written(run, largest_mb=1e-4)
    assert [*data.parent.iterdir()] == [own], "what lay beside an earlier page is gone"
    own.unlink()
    assert not written(run).count("report_files")
    assert not data.parent.exists()
    assert f"stereogs report {run.path} --beside" in small
    assert "scene-data" not in small


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
