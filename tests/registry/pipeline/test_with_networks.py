"""`with_networks` is `weightfree` and two networks, nothing else."""

from __future__ import annotations

from pathlib import Path

import pytest

from registry.pipeline.pipeline import Pipeline, load_pipeline
from registry.plugins.discovery import SELECTION, Plugins

PIPELINES = Path(__file__).parents[3] / "pipelines"


@pytest.fixture(autouse=True)
def _environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(SELECTION)
    monkeypatch.setenv("STEREOGS_DATA", "data")
    monkeypatch.setenv("STEREOGS_MODELS", "models")


def load(name: str) -> Pipeline:
    return load_pipeline(PIPELINES / f"{name}.yaml", Plugins())


def test_it_differs_from_weightfree_by_the_networks_alone() -> None:
    without, beside = load("weightfree"), load("with_networks")
    assert without.training == beside.training
    differing = {s for s in without.items if without.items[s] != beside.items[s]}
    assert differing == {"priors", "initializer", "regularizers"}
    assert [item.name for item in beside.items["priors"]][:2] == ["plane_sweep", "patch_match"]
    first, second = (p.one("initializer").settings.model_dump() for p in (without, beside))
    assert [name for name in first if first[name] != second[name]] == ["prior"]
    assert without.items["regularizers"] == ()
    assert [item.name for item in beside.items["regularizers"]] == ["stereo_depth"]
