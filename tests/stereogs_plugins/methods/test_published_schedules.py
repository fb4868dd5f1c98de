"""Iterations at which published methods act, as their authors' code has them."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest

from stereogs import Pipeline
from tests.host import Item, Plugins, load_pipeline

FOLDER = Path(__file__).parents[3] / "pipelines" / "methods"


@pytest.fixture(autouse=True)
def _folders(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STEREOGS_MODELS", "models")
    monkeypatch.setenv("STEREOGS_DATA", "data")


def published(name: str) -> Pipeline:
    return load_pipeline(FOLDER / f"{name}.yaml", Plugins())


def calls(pipeline: Pipeline, section: str, name: str) -> list[int]:
    """The iterations in which a component is called."""
    (item,) = (one for one in pipeline.items[section] if one.name == name)
    assert isinstance(item, Item)
    return [i for i in range(1, pipeline.training.iterations + 1) if item.schedule.due(i)]


def test_corgs_resets_and_prunes_when_its_code_does() -> None:
    corgs = published("cor-gs")
    assert calls(corgs, "opacity", "opacity_reset") == [501, 3501, 6501, 9501]
    assert calls(corgs, "densification", "co_pruning") == [*range(1000, 10_001, 500)]
    assert calls(corgs, "regularizers", "field_agreement") == [*range(500, 10_001)]
    (reset,) = corgs.items["opacity"]
    assert reset.settings.model_dump() | {"ceiling": 0.05, "recovery": 0} == (
        reset.settings.model_dump()
    )


def test_nexusgs_resets_when_its_code_does() -> None:
    nexusgs = published("nexusgs")
    assert calls(nexusgs, "opacity", "opacity_reset") == [*range(2001, 30_000, 3000)]
    assert nexusgs.training.learning_rates.scale == 0.03


def test_mvpgs_resets_once_and_warps_every_third_time() -> None:
    mvpgs = published("mvpgs")
    assert calls(mvpgs, "opacity", "opacity_reset") == [3000]
    assert calls(mvpgs, "densification", "gradient_threshold")[-1] == 4900
    assert calls(mvpgs, "regularizers", "forward_warping")[:3] == [3, 6, 9]


def test_dngaussian_begins_soft_depth_after_1000_and_clears_before_cameras_after_2000() -> None:
    dngaussian = published("dngaussian")
    assert calls(dngaussian, "regularizers", "hard_depth")[0] == 1
    assert calls(dngaussian, "regularizers", "soft_depth")[0] == 1001
    assert calls(dngaussian, "densification", "never_seen") == [1]
    assert calls(dngaussian, "densification", "before_cameras")[:2] == [2025, 2050]


def test_dngaussian_and_its_short_form_step_as_far_as_its_script_for_llff() -> None:
    """--position_lr_init 0.016, --position_lr_final 0.00016, --scaling_lr 0.003."""
    for name in ("dngaussian", "dngaussian-short"):
        rates = published(name).training.learning_rates
        assert (rates.position, rates.position_final, rates.scale) == (0.016, 0.00016, 0.003)


@pytest.mark.parametrize("name", ["regnerf", "freenerf", "sparsenerf", "ico-gs"])
def test_methods_made_for_fields_of_radiance_share_one_schedule(name: str) -> None:
    pipeline = published(name)
    assert pipeline.training.iterations == 10_000
    assert calls(pipeline, "opacity", "opacity_reset") == [3000, 6000, 9000]
    assert calls(pipeline, "densification", "gradient_threshold") == [*range(600, 10_000, 100)]


def test_icogs_looks_photographs_up_in_the_last_sixth() -> None:
    assert (
        len(calls(published("ico-gs"), "regularizers", "cycle_filtered_warping")) == 10_000 // 6 + 1
    )


RECOVERY = 500
"""Iterations that the optimizer needs to bring opacities back from a reset, however long the run."""


@pytest.mark.parametrize("file", sorted(FOLDER.glob("*-short.yaml")), ids=lambda file: file.stem)
def test_resets_of_a_short_run_leave_opacities_time_to_come_back(file: Path) -> None:
    pipeline = load_pipeline(file, Plugins())
    end = pipeline.training.iterations
    for item in pipeline.items["opacity"]:
        settings = item.settings.model_dump()
        if item.host.use == "opacity_reset" and settings["ceiling"] < 0.1:
            due = calls(pipeline, "opacity", item.name)
            resets = [i for i in due if end - i >= settings["recovery"]]
            gaps = [b - a for a, b in itertools.pairwise([*resets, end])]
            assert min(gaps, default=end) >= RECOVERY, item.name
