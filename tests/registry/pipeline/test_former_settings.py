"""Pipelines of old runs open after settings were renamed or removed."""

from __future__ import annotations

import pytest

from registry.pipeline.pipeline import Item, parse_pipeline
from tests.host import SELECTION, PipelineError, Plugins
from tests.registry.toy_plugin import ToyTermSettings


@pytest.fixture(autouse=True)
def _history(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ToyTermSettings, "renamed", {"goal": "target"})
    monkeypatch.setattr(ToyTermSettings, "removed", {"steepness": 100.0})


def term(toys: Plugins, written: str) -> Item:
    text = (
        "name: t\nscene: toy_scene\ninitializer: toy_points\nregularizers:\n"
        f"  - {{use: toy_term, {written}}}\n"
    )
    pipeline = parse_pipeline(text, toys, source="old.yaml")
    (item,) = pipeline.items["regularizers"]
    assert "goal" not in pipeline.to_yaml(), "runs are written with the present names"
    return item


def test_a_former_name_is_understood_with_one_warning(
    toys: Plugins, caplog: pytest.LogCaptureFixture
) -> None:
    item = term(toys, "goal: 0.25")
    assert item.settings.model_dump()["target"] == 0.25
    assert caplog.messages == [
        "old.yaml:5: the setting regularizers.toy_term.goal is now called target"
    ]


def test_a_former_and_a_present_name_contradict_each_other(toys: Plugins) -> None:
    with pytest.raises(PipelineError, match="'goal' and 'target'") as caught:
        term(toys, "goal: 0.25, target: 0.25")
    assert (caught.value.where, caught.value.fix) == ("old.yaml:5", "remove 'goal'")


def test_a_value_under_a_former_name_is_checked(toys: Plugins) -> None:
    with pytest.raises(PipelineError, match=r"toy_term\.target must be a number, not 'high'"):
        term(toys, "goal: high")


def test_a_removed_setting_may_keep_its_value_and_no_other(
    toys: Plugins, caplog: pytest.LogCaptureFixture
) -> None:
    assert term(toys, "steepness: 100.0").settings == term(toys, "steepness: 100").settings
    assert caplog.messages == []
    with pytest.raises(PipelineError, match=r"always 100\.0, not 50") as caught:
        term(toys, "steepness: 50")
    assert (caught.value.where, caught.value.fix) == ("old.yaml:5", "remove 'steepness'")


def test_shipped_components_open_pipelines_with_their_removed_settings(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv(SELECTION)
    text = (
        "name: old\nscene: procedural\ninitializer: {use: sfm, min_triangulation_angle: 1.5}\npriors:\n"
        "  - {use: patch_match, near_margin: 0.9, far_margin: 1.2}\n"
        "  - {use: plane_sweep, near_margin: 0.9, far_margin: 1.2}\nregularizers:\n"
        "  - {use: patch_depth, form: hard, local_weight: 0.1, global_weight: 1.0}\n"
        "  - {use: stereo_depth, background_level: 30}\n"
        "perturbations: [{use: position_noise, steepness: 100.0}]\n"
    )
    assert len(parse_pipeline(text, Plugins()).items["priors"]) == 2
