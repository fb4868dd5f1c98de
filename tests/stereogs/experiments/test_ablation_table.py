"""The tables, the CSV and the page contain the results of the runs."""

from __future__ import annotations

import csv
import io
import math
import re
import statistics
from pathlib import Path
from typing import Any

import pytest
import torch
from PIL import Image

from registry.toolkit.drawing import ViewPictures, save_png, side_by_side
from registry.toolkit.web_page import Cell
from stereogs.experiments.planning.plan import Plan
from stereogs.experiments.running.folder import ExperimentFolder
from stereogs.experiments.showing import scores
from stereogs.experiments.showing.page import as_page, plots
from stereogs.experiments.showing.table import (
    as_csv,
    as_latex,
    as_text,
    means_as_csv,
    scene_table,
)
from tests.host import Plugins, write_json
from tests.html_page import Page
from tests.stereogs.experiments.ablating import plan, write

Results = dict[Any, dict[str, Any]]


@pytest.fixture
def made(toys: Plugins, tmp_path: Path) -> Plan:
    """A toggle, a varied number, two scenes, two seeds: 3 combinations, 12 runs."""
    path = write(tmp_path, "toggles: {opacity: {off: {use: toy_fade, reset: true}}}\n")
    return plan(path, toys, vary=("opacity.factor=0.5,0.6",), scenes="./a,./<b>", seeds=2)


def measured(made: Plan) -> Results:
    """Return results in which all numbers differ."""
    return {
        run: {
            "test": {"psnr": 20 + index, "ssim": 0.5 + 0.01 * index},
            "gaussians": 1000 + index,
            "seconds": 10.0 + index,
            "peak_memory_mb": None,
            "hash": f"{index:x}",
        }
        for index, run in enumerate(made.runs)
    }


def test_a_row_is_the_mean_of_its_runs(made: Plan) -> None:
    results = measured(made)
    psnr = scores.columns(made, results)[0]
    assert psnr == scores.Column("psnr", "psnr", True)
    # The first combination's runs are scene a with seeds 7 and 8, then scene <b> with both.
    first = made.combinations[0]
    assert scores.figure(results, first, psnr) == scores.Figure(21.5, statistics.stdev([21, 22]))
    assert scores.figure(results, first, psnr, "<b>") == scores.Figure(
        22.5, statistics.stdev([22, 23])
    )
    table = scene_table(made, results, "mean", mean=True)
    assert (table.head[2], table.names) == ("psnr ↑", 2)
    assert [row[2] for row in table.rows] == [
        Cell("21.50 ± 0.71"),
        Cell("25.50 ± 0.71"),
        Cell("29.50 ± 0.71", strong=True),
    ]


def test_the_text_has_a_table_for_the_mean_and_each_scene(made: Plan) -> None:
    text = as_text(made, measured(made))
    lines = [line.split() for line in text.splitlines()]
    assert text.count("psnr ↑") == 3
    assert "peak MB" not in text, "nobody measured it"
    assert ["✗", "-", "21.50", "±", "0.71", "0.5150", "±", "0.0071", "1,002", "11.5"] in lines
    assert ["✓", "0.5", "25.50", "±", "0.71", "0.5550", "±", "0.0071", "1,006", "15.5"] in lines
    assert ["✓", "0.6", "30.50", "±", "0.71", "0.6050", "±", "0.0071", "1,010", "20.5"] in lines
    assert "± standard deviation over 2 seeds" in text


def test_a_row_with_a_missing_run_has_no_numbers(made: Plan) -> None:
    results = measured(made)
    results[made.runs[1]] = {}
    table = scene_table(made, results, "mean", mean=True)
    assert {cell.text for cell in table.rows[0][2:-1]} == {"-"}
    assert table.head[-1] == "runs"
    assert [row[-1].text for row in table.rows] == ["3/4", "", ""]
    assert "3/4" in as_text(made, results)
    text = as_text(made, {run: {} for run in made.runs})
    assert (text.count("0/4"), text.count("0/2")) == (3, 6), "a scene's table counts its own runs"
    assert [row[-1].text for row in scene_table(made, results, "a").rows] == ["1/2", "", ""]
    assert "runs" not in scene_table(made, results, "<b>").head


def test_combinations_without_effect_are_listed(made: Plan) -> None:
    results = measured(made)
    assert "no effect" not in as_text(made, results)
    off, half = made.combinations[:2]
    pairs = [[run for run in made.runs if run.combination == c] for c in (off, half)]
    for one, two in zip(*pairs, strict=True):
        results[two]["hash"] = results[one]["hash"]
    expected = "no effect, bitwise equal Gaussians: opacity off = opacity on, opacity.factor 0.5"
    assert expected in as_text(made, results).splitlines()
    results[pairs[1][-1]] = {}
    text = as_text(made, results)
    assert expected not in text, "a run is missing"
    assert expected.replace("no effect", "no effect on a") in text.splitlines()
    assert "on <b>" not in text


def test_infinite_and_unavailable_scores(made: Plan) -> None:
    results = measured(made)
    for found in results.values():
        found["test"] |= {"lpips": None}
        found["unavailable"] = {"lpips": "there is no model file"}
    results[made.runs[0]]["test"]["psnr"] = None
    results[made.runs[0]]["infinite"] = {"test": {"psnr": ["view1"]}}
    assert [column.key for column in scores.columns(made, results)][:3] == [
        "psnr",
        "ssim",
        "gaussians",
    ]
    table = scene_table(made, results, "mean", mean=True)
    assert table.rows[0][2] == Cell("inf", strong=True)
    assert math.isinf(scores.value(results[made.runs[0]], scores.columns(made, results)[0]) or 0)
    assert "- lpips: there is no model file" in as_text(made, results)


def test_the_means_as_csv_and_latex(toys: Plugins, tmp_path: Path) -> None:
    made = plan(write(tmp_path), toys, vary=("opacity.factor=0.5,0.6",), seeds=3)
    results = measured(made)
    rows = list(csv.DictReader(io.StringIO(means_as_csv(made, results))))
    psnr, gained = [row for row in rows if row["quantity"] == "psnr"]
    # Seeds differ by 1: standard deviation 1; Student's t with two degrees of freedom.
    half = 4.302652729911275 / math.sqrt(3)
    assert (psnr["scene"], psnr["mean"], psnr["deviation"]) == ("garden", "21", "1")
    assert float(psnr["interval"]) == pytest.approx(half)
    assert (psnr["difference"], psnr["difference_interval"]) == ("", "")
    assert (gained["mean"], gained["difference"], gained["difference_interval"]) == ("24", "3", "0")
    text = as_latex(made, results)
    assert r"0.6 & \textbf{24.00 $\pm$ 1.00} & " in text
    assert r"factor & psnr $\uparrow$ & " in text
    assert text.count(r"\end{tabular}") == 2
    results[made.runs[0]] = {}
    first, _ = list(csv.DictReader(io.StringIO(means_as_csv(made, results))))[:2]
    assert first["mean"] == ""


def test_a_difference_is_never_minus_zero() -> None:
    assert scores.Difference(-0.001, 0.3).text() == "+0.00 ± 0.30"


def test_the_csv_has_a_row_per_run(made: Plan, tmp_path: Path) -> None:
    results = measured(made)
    results[made.runs[2]] = {}
    found = list(csv.DictReader(io.StringIO(as_csv(made, results, ExperimentFolder(tmp_path)))))
    assert len(found) == 12
    assert found[0] | {"folder": ""} == {
        "opacity": "0",
        "opacity.factor": "",
        "scene": "a",
        "seed": "7",
        "psnr": "20",
        "ssim": "0.5",
        "gaussians": "1000",
        "seconds": "10",
        "hash": "0",
        "folder": "",
    }
    assert (found[2]["scene"], found[2]["psnr"]) == ("<b>", "")
    assert (found[11]["opacity"], found[11]["opacity.factor"], found[11]["psnr"]) == (
        "1",
        "0.6",
        "31",
    )
    assert found[0]["folder"] == f"runs/{made.runs[0].name}"


def _color(picture: Image.Image) -> str:
    """Return which of two colors an 8x6 image has."""
    assert picture.size == (8, 6)
    pixel = picture.getpixel((7, 5))
    assert isinstance(pixel, tuple)
    return "red" if pixel[0] > pixel[2] else "blue"


def test_the_page_needs_no_other_file_and_escapes_html(made: Plan, tmp_path: Path) -> None:
    results = measured(made)
    folder = ExperimentFolder(tmp_path)
    for run, found in results.items():
        found["views"] = {"test": {"<view>.png": {"psnr": 21.0}}}
        files = ViewPictures.of("<view>.png", tmp_path / "runs" / run.name / "renders")
        for file in (files.depth, files.comparison):
            file.parent.mkdir(parents=True)
        red, blue = torch.zeros(6, 8, 3), torch.zeros(6, 8, 3)
        red[..., 0], blue[..., 2] = 1, 1
        save_png(blue, files.render)
        save_png(blue, files.depth)
        save_png(side_by_side(red, blue, blue), files.comparison)
    text = as_page(made, results, folder)
    page = Page(text)
    assert "<b>" not in text
    assert "<view>" not in text
    assert "<b>" in page.text
    assert "opacity on, opacity.factor 0.6, psnr 21" in page.text
    assert page.tags.count("table") == 4, "the mean, two scenes, differences"
    assert page.tags.count("svg") == 2, "psnr and ssim against the factor"
    assert page.tags.count("circle") == 4, "two points a plot; the row that is off has none"
    # For each scene the photograph, and each combination's render and depth for the first seed.
    assert [image["alt"] for image in page.images] == ["photograph", *["render", "depth"] * 3] * 2
    # The photograph is red, renders and depths are blue.
    assert [_color(picture) for picture in page.pictures()] == ["red", *["blue"] * 6] * 2
    assert "http" not in text


def test_plots_sort_numbers_and_join_nothing_else(toys: Plugins, tmp_path: Path) -> None:
    vary = ("opacity.factor=0.9,0.5,0.6", "opacity.reset=false,true")
    made = plan(write(tmp_path), toys, vary=vary)
    results = {run: {"test": {"psnr": 20.0 + i}} for i, run in enumerate(made.runs)}
    (numbers,) = plots(made, results)
    line = re.findall(r'polyline points="([^"]*)"', numbers)[0]
    places = [tuple(map(float, point.split(","))) for point in line.split()]
    (left, y_left), (middle, y_middle), (right, y_right) = places
    assert (middle - left) / (right - left) == pytest.approx(0.25, abs=0.01)
    # 22, 24 and 20 dB; an SVG's y grows downwards.
    assert y_middle < y_left < y_right
    assert len(re.findall("<polyline", numbers)) == 2, "one for each choice of reset"


def test_the_page_without_finished_runs(made: Plan, tmp_path: Path) -> None:
    page = Page(as_page(made, {run: {} for run in made.runs}, ExperimentFolder(tmp_path)))
    assert page.tags.count("table") == 3
    assert page.tags.count("svg") == len(page.images) == 0


def test_results_of_another_pipeline_and_damaged_results_are_ignored(
    made: Plan, tmp_path: Path
) -> None:
    folder = ExperimentFolder(tmp_path)
    run = made.runs[0]
    path = folder.run(run).path
    path.mkdir(parents=True)
    write_json(path / "results.json", {"seconds": 1})
    assert folder.results(run) == {}, "it has no pipeline"
    (path / "pipeline.yaml").write_text(run.pipeline.to_yaml())
    assert folder.results(run) == {"seconds": 1}
    (path / "results.json").write_text("{")
    assert folder.results(run) == {}
    write_json(path / "results.json", {"seconds": 1})
    (path / "pipeline.yaml").write_text(made.runs[1].pipeline.to_yaml())
    assert folder.results(run) == {}


def test_a_folder_is_found_by_its_digest(made: Plan, tmp_path: Path) -> None:
    folder = ExperimentFolder(tmp_path)
    run = made.runs[0]
    renamed = tmp_path / "runs" / f"my-favourite_{run.digest}"
    renamed.mkdir(parents=True)
    assert folder.run(run).path == renamed
    assert folder.run(made.runs[1]).path.name == made.runs[1].name
    names = [run.name.removesuffix(f"_{run.digest}") for run in made.runs]
    assert names[0] == "a_seed-7_all-off"
    assert names[-1] == "b_seed-8_opacity_factor-0.6"
