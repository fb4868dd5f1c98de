"""Labels of runs name what differs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from stereogs.experiments.comparing.comparison import FinishedRun
from stereogs.experiments.comparing.labels import labels
from tests.host import SELECTION, Plugins, load_pipeline, parse_yaml, plain
from tests.stereogs.experiments.comparing.conftest import Make, runs


@pytest.fixture(autouse=True)
def all_plugins(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(SELECTION, raising=False)


def trained(*changes: str, disable: tuple[str, ...] = (), iterations: int = 0) -> FinishedRun:
    """A run of the ready pipeline `demo` with changes, as its folder has it."""
    pipeline = load_pipeline(Path("demo"), Plugins(), overrides=changes, disabled=disable)
    if iterations:
        pipeline = pipeline.scaled(iterations)
    tree: dict[str, Any] = plain(parse_yaml(pipeline.to_yaml(), "pipeline.yaml"))
    return FinishedRun(Path("run"), {"pipeline": "demo"}, tree, "")


def test_runs_of_different_lengths() -> None:
    by_setting = [trained(f"training.iterations={n}") for n in (100, 200, 600)]
    assert labels(by_setting) == ["100 iterations", "200 iterations", "600 iterations"]
    assert by_setting[0].tree["densification"]["start"] > 100, "the shortest run does without it"
    scaled = [trained(iterations=n) for n in (77, 201, 600)]
    assert labels(scaled) == ["77 iterations", "201 iterations", "600 iterations"]
    later = [trained(), trained("densification.start=101", "densification.phase=0")]
    assert labels(later) == ["densification.start=100", "densification.start=101"]
    changed = [trained("training.iterations=200", "densification.start=120"), trained()]
    assert labels(changed)[0] == "densification.start=120, densification.phase=20, 200 iterations"


def test_a_replaced_component_is_named_without_its_settings() -> None:
    constant = "opacity={use: constant_decay, factor: 0.995}"
    found = [
        trained(),
        trained(constant),
        trained(disable=("dropout",)),
        trained("training.seed=1"),
    ]
    assert labels(found) == [
        "dropout, opacity gradient_aware_decay, seed 0",
        "dropout, opacity constant_decay, seed 0",
        "no dropout, opacity gradient_aware_decay, seed 0",
        "dropout, opacity gradient_aware_decay, seed 1",
    ]


def test_several_pipelines(make: Make) -> None:
    longer = {"training/iterations": 2000, "training/seed": 1}
    other = {"name": "other"}
    found = runs(make("a"), make("b", None, longer), make("c", {"pipeline": "other"}, other))
    assert labels(found) == [
        "plain, 1000 iterations, seed 0",
        "plain, 2000 iterations, seed 1",
        "other",
    ]


def test_a_label_names_three_differences(make: Make) -> None:
    many = {
        "training/iterations": 2000,
        "training/seed": 1,
        "initializer/use": "random",
        "scene/train_views": 6,
    }
    assert labels(runs(make("d"), make("e", None, many)))[1] == (
        "6 training views, initializer random, 2000 iterations, 1 more"
    )


@pytest.mark.parametrize(("value", "text"), [("png8", "png8"), (None, "null"), (True, "true")])
def test_settings_are_written_as_in_a_pipeline(make: Make, value: object, text: str) -> None:
    weights = [{"metrics": [{"use": "psnr", "quantize": q}]} for q in (value, 9)]
    found = labels(runs(make("f", None, weights[0]), make("g", None, weights[1])))
    assert found == [f"metrics.psnr.quantize={text}", "metrics.psnr.quantize=9"]
