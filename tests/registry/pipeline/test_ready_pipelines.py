"""The ready pipelines say what they claim: StereoGS's the paper's numbers, others what they share."""

from __future__ import annotations

from pathlib import Path

import pytest

from registry.pipeline.pipeline import Item, Pipeline, load_pipeline
from tests.host import SELECTION, Plugins

PIPELINES = Path(__file__).parents[3] / "pipelines"


@pytest.fixture(autouse=True)
def _environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(SELECTION)
    monkeypatch.setenv("STEREOGS_DATA", "data")
    monkeypatch.setenv("STEREOGS_MODELS", "models")


def load(name: str) -> Pipeline:
    return load_pipeline(PIPELINES / f"{name}.yaml", Plugins())


def only(pipeline: Pipeline, section: str) -> Item:
    """The section's component; of StereoGS's terms the paper's, not that on the background."""
    (item,) = (item for item in pipeline.items[section] if item.name != "empty_background")
    return item


def test_the_papers_schedule_and_numbers() -> None:
    pipeline = load("stereogs")
    assert pipeline.training.iterations == 30_000
    stereo = only(pipeline, "regularizers")
    assert (stereo.schedule.start, stereo.schedule.stop, stereo.schedule.every) == (20_001, None, 1)
    assert stereo.host.weight == 1
    assert stereo.settings.model_dump(include={"tau", "validity_mask", "refresh_threshold"}) == {
        "tau": 2.0,
        "validity_mask": True,
        "refresh_threshold": 0,
    }
    growth = only(pipeline, "densification")
    assert (growth.schedule.start, growth.schedule.stop, growth.schedule.every) == (1000, None, 100)
    assert growth.settings.model_dump()["size_prune_from"] is None
    decay = only(pipeline, "opacity")
    assert decay.schedule.start == 1001
    assert decay.settings.model_dump(include={"function", "base", "sensitivity"}) == {
        "function": "exp_beta",
        "base": 0.99,
        "sensitivity": 0.5,
    }
    assert pipeline.items["modifiers"] == ()


@pytest.mark.parametrize("short", ["", "_short"])
def test_the_starred_rows_differ_by_dropout_alone(short: str) -> None:
    plain, starred = load(f"stereogs{short}"), load(f"stereogs_dropout{short}")
    assert only(starred, "modifiers").settings.model_dump() == {
        "rate": 0.3,
        "ramp": False,
        "compensate": True,
    }
    for section in plain.items:
        if section != "modifiers":
            assert starred.items[section] == plain.items[section], section
    assert starred.training == plain.training


@pytest.mark.parametrize("name", ["stereogs_weightfree", "stereogs_short"])
def test_the_short_ones_have_the_same_parts_at_the_same_shares(name: str) -> None:
    paper, short = load("stereogs"), load(name)
    for section in ("initializer", "regularizers", "densification", "opacity"):
        assert only(short, section).host.use == only(paper, section).host.use
    for section in ("regularizers", "densification", "opacity"):
        shares = [
            only(pipeline, section).schedule.start / pipeline.training.iterations
            for pipeline in (paper, short)
        ]
        assert shares[1] == pytest.approx(shares[0], abs=0.07), section
    for section in ("regularizers", "opacity"):
        assert only(short, section).settings.model_dump(exclude={"refresh_threshold"}) == only(
            paper, section
        ).settings.model_dump(exclude={"refresh_threshold"})
    assert [item.name for item in short.items["priors"]] == [
        item.name for item in paper.items["priors"]
    ]


def test_weightfree_best_is_weightfree_with_three_times_the_iterations() -> None:
    short, long = load("weightfree"), load("weightfree_best")
    assert (short.iterations_per_view, long.iterations_per_view) == (300, 900)
    lengths = {"iterations": 2700}
    assert short.training.model_copy(update=lengths) == long.training.model_copy(update=lengths)
    assert short.items["regularizers"][0].settings == long.items["regularizers"][0].settings
    for section in ("priors", "initializer", "modifiers", "densification", "opacity"):
        assert [item.settings for item in short.items[section]] == [
            item.settings for item in long.items[section]
        ]


def test_with_networks_differs_from_weightfree_by_priors_initializer_and_stereo_term() -> None:
    without, beside = load("weightfree"), load("with_networks")
    assert without.training == beside.training
    differing = {s for s in without.items if without.items[s] != beside.items[s]}
    assert differing == {"priors", "initializer", "regularizers"}
    names = [item.name for item in beside.items["priors"]]
    assert names == ["plane_sweep", "learned", "patch_match", "multi_view", "stereo"]
    first, second = (p.one("initializer").settings.model_dump() for p in (without, beside))
    assert [name for name in first if first[name] != second[name]] == ["prior"]
    terms = [[item.name for item in p.items["regularizers"]] for p in (without, beside)]
    assert terms == [["virtual_stereo"], ["stereo_depth", "virtual_stereo"]]
    assert without.one("regularizers") in beside.items["regularizers"]
