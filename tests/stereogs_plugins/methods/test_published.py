"""The whole pipelines come in the iterations that the authors' code has."""

from __future__ import annotations

from pathlib import Path

import pytest

from stereogs import Pipeline
from tests.host import Plugins, load_pipeline

FOLDER = Path(__file__).parents[3] / "pipelines" / "methods"
HUNDREDS_TO_15000 = list(range(600, 15_000, 100))
HUNDREDS_TO_10000 = list(range(600, 10_000, 100))
PUBLISHED = {
    "3dgs": {
        "densification.gradient_threshold": HUNDREDS_TO_15000,
        "opacity.opacity_reset": [3000, 6000, 9000, 12_000],
        "opacity.white_background": [500],
    },
    "dropgaussian": {
        "densification.gradient_threshold": HUNDREDS_TO_10000,
        "opacity.opacity_reset": [3000, 6000, 9000],
    },
    "mcmc": {
        "densification.move_the_dead": list(range(600, 25_000, 100)),
        "densification.faint_growth": list(range(600, 25_000, 100)),
        "densification.place_the_new": list(range(600, 25_000, 100)),
        "perturbations.position_noise": list(range(1, 30_001)),
    },
    "binocular3dgs": {
        "densification.gradient_threshold": list(range(600, 30_001, 100)),
        "opacity.constant_decay": list(range(501, 30_001)),
        "regularizers.virtual_stereo": list(range(20_001, 30_001)),
    },
    "fsgs": {
        "densification.gradient_threshold": HUNDREDS_TO_10000,
        "densification.proximity_unpooling": list(range(600, 2000, 100)),
        "regularizers.pearson_depth": list(range(1, 9501)),
        "regularizers.pearson_depth_late": list(range(9501, 10_001)),
        "regularizers.pearson_depth_virtual": list(range(2001, 9500)),
        "opacity.opacity_reset": [2001, 5001, 8001],
    },
    "d2gs": {
        "densification.gradient_threshold": HUNDREDS_TO_10000,
        "opacity.opacity_reset": [3000, 6000, 9000],
    },
    "co-adaptation": {
        "opacity.constant_decay": list(range(501, 30_001)),
        "opacity.expected_opacity": [30_000],
    },
    "absgs": {
        "densification.gradient_threshold": HUNDREDS_TO_15000,
        "opacity.opacity_cap": list(range(500, 15_000, 500)),
        "opacity.opacity_reset": [3000, 6000, 9000, 12_000],
    },
}


@pytest.fixture(autouse=True)
def _environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STEREOGS_DATA", "data")
    monkeypatch.setenv("STEREOGS_MODELS", "models")


def load(name: str) -> Pipeline:
    return load_pipeline(FOLDER / f"{name}.yaml", Plugins())


@pytest.mark.parametrize("name", PUBLISHED)
def test_each_part_is_due_when_the_code_has_it(name: str) -> None:
    pipeline = load(name)
    iterations = range(1, pipeline.training.iterations + 1)
    items = {item.qualified_name: item for item in pipeline}
    for part, expected in PUBLISHED[name].items():
        assert list(filter(items[part].schedule.due, iterations)) == expected, part


@pytest.mark.parametrize("name", ["dropgaussian", "d2gs"])
def test_l1_has_its_whole_weight_where_the_code_gives_it(name: str) -> None:
    training = load(name).training
    assert (training.l1_weight, training.ssim_weight) == (1, 0.2)
