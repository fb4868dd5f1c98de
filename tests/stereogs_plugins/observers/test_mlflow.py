from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from registry.testing import check
from stereogs_plugins.observers.mlflow import MlflowObserver
from tests.stereogs_plugins.observers.heard import CURVES, failed, stopped_and_resumed

pytest.importorskip("mlflow")


def the_run(folder: Path) -> tuple[Any, Any]:
    """A client of the folder's database, and its one run."""
    from mlflow import MlflowClient  # type: ignore[import-not-found, unused-ignore]

    client = MlflowClient(f"sqlite:///{folder / 'mlflow.db'}")
    experiment = client.get_experiment_by_name("stereogs")
    assert experiment is not None
    (run,) = client.search_runs([experiment.experiment_id])
    return client, run


def test_it_keeps_the_contract() -> None:
    check(MlflowObserver)


def test_mlflow_reads_what_was_told(tmp_path: Path) -> None:
    run, folder = stopped_and_resumed("mlflow", tmp_path / "run")
    client, kept = the_run(folder)
    assert kept.info.status == "FINISHED"
    assert kept.info.run_name == "run"
    assert kept.data.metrics.keys() >= CURVES | {"test/psnr", "train/psnr"}
    steps = [metric.step for metric in client.get_metric_history(kept.info.run_id, "loss")]
    assert steps == [2, 4, 6]
    assert kept.data.metrics["gaussians"] == run.model.count
    assert kept.data.metrics["test/psnr"] == pytest.approx(run.scores["test"].mean["psnr"])
    artifacts = folder / "artifacts" / kept.info.run_id / "artifacts"
    written = json.loads((artifacts / "pipeline.json").read_text())
    assert written["training"]["iterations"] == 6
    (picture,) = (artifacts / "views").glob("*/*.png")
    assert picture.name == "0000004.png"


def test_a_run_that_fails_has_failed_there_too(tmp_path: Path) -> None:
    _, kept = the_run(failed("mlflow", tmp_path / "run"))
    assert kept.info.status == "FAILED"
    assert "no such luck" in kept.data.tags["error"]
