"""LPIPS by two networks, whatever the planned pipeline names."""

from __future__ import annotations

import pytest

from benchmarks.cells import ALEXNET, VGG
from benchmarks.training_process import with_alexnet
from stereogs import Pipeline, build_pipeline


@pytest.fixture(autouse=True)
def _models(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STEREOGS_MODELS", "a folder of ${models}")


def pipeline(metrics: str) -> Pipeline:
    return build_pipeline(f"name: tiny\ninitializer: random\nmetrics: {metrics}\n")


def test_a_pipeline_with_lpips_gets_alexnets_too() -> None:
    both = with_alexnet(pipeline("[psnr, lpips]"))
    assert [item.name for item in both.items["metrics"]] == ["psnr", VGG, ALEXNET]
    networks = [item.settings.model_dump().get("network") for item in both.items["metrics"]]
    assert networks == [None, "vgg", "alex"]
    rest = both.plain() | {"metrics": None}
    assert rest == pipeline("[psnr, lpips]").plain() | {"metrics": None}


@pytest.mark.parametrize(
    "metrics", ["[psnr]", f"[lpips, {{use: lpips, name: {ALEXNET}, network: alex}}]"]
)
def test_any_other_stays_as_it_is(metrics: str) -> None:
    planned = pipeline(metrics)
    assert with_alexnet(planned) is planned
