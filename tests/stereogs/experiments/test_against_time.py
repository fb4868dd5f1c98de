"""Scores against time: curves from run folders, the Pareto front, and tables at equal time."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from stereogs.experiments.planning.matrix import plan_of, read_matrix
from stereogs.experiments.planning.plan import Plan
from stereogs.experiments.running.folder import ExperimentFolder
from stereogs.experiments.showing.against_time import (
    Reference,
    Sample,
    curve,
    front,
    published_costs,
    reached,
    read_curves,
)
from stereogs.experiments.showing.page import as_page
from stereogs.experiments.showing.scores import Results
from tests.host import AppliedProtocol, Plugins, load_protocol
from tests.html_page import Page
from tests.stereogs.experiments.test_bench import matrix

MATRIX = """\
pipelines: [toy, ./other.yaml]
scenes: [{use: toy_scene, name: garden}, {use: toy_scene, name: yard}]
seeds: 2
"""


@pytest.fixture
def made(toys: Plugins, tmp_path: Path) -> Plan:
    return plan_of(read_matrix(matrix(tmp_path, MATRIX)), toys)


@pytest.fixture
def folder(made: Plan, tmp_path: Path) -> ExperimentFolder:
    """Write run folders with scores during training: 2 dB and 1 s per iteration."""
    folder = ExperimentFolder(tmp_path / "out")
    for run in made.runs:
        place = folder.run(run).path
        place.mkdir(parents=True)
        lines: list[dict[str, Any]] = [{"iteration": 1, "seconds": 1.0, "gaussians": 5}]
        lines += [
            {
                "iteration": i,
                "seconds": float(i),
                "test": {"psnr": psnr(run.seed, run.pipeline.name, i)},
            }
            for i in (2, 4, 5)
        ]
        text = "".join(f"{json.dumps(line)}\n" for line in lines)
        (place / "metrics.jsonl").write_text(text + '{"iteration": 6, "te')
    return folder


@pytest.fixture
def results(made: Plan) -> Results:
    return {
        run: {
            "iterations": 5,
            "seconds": 5.0,
            "stages": {"scene": 0.5, "initialization": 1.5, "training": 5.0},
            "test": {"psnr": psnr(run.seed, run.pipeline.name, 5) + 1, "lpips": 0.4, "odd": None},
            "unavailable": {"odd": "no file"},
            "gaussians": 7,
            "hash": run.digest,
        }
        for run in made.runs
    }


def psnr(seed: int, pipeline: str, iteration: int) -> float:
    return 10 + 2 * iteration + seed + (3 if pipeline == "other" else 0)


def test_a_curve_includes_loading_and_initialization_and_ends_with_the_final_scores(
    made: Plan, results: Results, folder: ExperimentFolder
) -> None:
    curves = read_curves(results, folder)
    found = curve(curves, made.combinations[0], "garden", "psnr")
    assert [(sample.seconds, sample.value) for sample in found] == [(4, 14.5), (6, 18.5), (7, 21.5)]
    assert found[0].spread == pytest.approx(math.sqrt(0.5))
    (last,) = curve(curves, made.combinations[0], "garden", "lpips")
    assert last.seconds == 7
    assert last.value == pytest.approx(0.4)
    assert curve(curves, made.combinations[0], "garden", "odd") == []


def test_the_reached_score_is_the_last_one_before_the_time(
    made: Plan, results: Results, folder: ExperimentFolder
) -> None:
    curves = read_curves(results, folder)
    first = made.combinations[0]
    assert reached(curves, first, "psnr", 3.9) is None
    by_then = reached(curves, first, "psnr", 6.5)
    assert by_then is not None
    assert by_then.mean == 18.5
    assert by_then.spread == pytest.approx(math.sqrt(0.5))
    late = next(run for run in made.runs if run.combination == first)
    slow = {**curves, late: [(i, after + 3, found) for i, after, found in curves[late]]}
    assert reached(slow, first, "psnr", 6.5) is None, "one of its runs has no score by then"


@pytest.mark.parametrize("higher", [True, False])
def test_the_front_contains_undominated_samples(higher: bool) -> None:
    sign = 1 if higher else -1
    points = {"a": (1, 5), "b": (2, 7), "c": (2, 6), "d": (3, 7), "e": (4, 9), "f": (9, 8)}
    samples = {name: Sample(t, sign * v) for name, (t, v) in points.items()}
    assert front(samples.values(), higher_is_better=higher) == {samples[n] for n in "abe"}


def test_the_page_of_a_bench(made: Plan, results: Results, folder: ExperimentFolder) -> None:
    row = Reference("Paper, 43 min on a large card", {"psnr": 19.0})
    text = as_page(made, results, folder, [row])
    page = Page(text)
    assert "Pareto front" in page.text
    assert "against pipeline" not in text, "no line joins different pipelines"
    assert page.text.count("Paper, 43 min on a large card") == 2, "psnr of two scenes"
    assert text.count("stroke-dasharray") == 2
    marks = "per scene: the better pipeline's three, and one lpips that both have"
    assert text.count('class="mark"') == 2 * (3 + 2), marks
    assert "psnr at equal time" in page.text
    assert "24.50 ± 0.71" in page.text, "other, at 20 s"
    assert "at 120 s" in page.text


def test_published_rows_need_a_common_protocol(made: Plan) -> None:
    assert published_costs(made) == []
    applied = AppliedProtocol(load_protocol("llff-3"), {})
    for run in made.runs:
        object.__setattr__(run.pipeline, "protocol", applied)
    labels = [row.label for row in published_costs(made)]
    assert "StereoGS, published: 43.2 min on one RTX 4090" in labels
    changed = AppliedProtocol(load_protocol("llff-3"), {"scene.background": None})
    object.__setattr__(made.runs[0].pipeline, "protocol", changed)
    assert published_costs(made) == []
