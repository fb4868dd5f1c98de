"""`mlflow`: an MLflow run, by default in a database in the run folder."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from registry import Observer, Register, hookimpl
from registry.events import IterationDone, RunEnded, RunStarted, ViewsScored
from registry.toolkit import LoggerSettings, optional_module

_IDENTITY = "stereogs.run"
"""Tag that identifies a resumed run."""


class MlflowSettings(LoggerSettings):
    experiment: str = "stereogs"
    """Name of the experiment; created if it does not exist."""
    tracking_uri: str | None = None
    """MLflow URI of a server or a database; null uses a database in the run folder."""


class MlflowObserver(Observer[MlflowSettings]):
    """An MLflow run, in files of the run folder by default; requires the extra `mlflow`."""

    client: Any = None
    run_id: str = ""

    def started(self, run: RunStarted) -> None:
        """Start a run, or continue the one with the same identity."""
        if run.folder is None:
            return
        # By default MLflow sends usage statistics over the network.
        os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
        mlflow = optional_module("mlflow", "pip install 'stereogs-plugins[mlflow]'")
        self.mlflow, own = mlflow, f"sqlite:///{run.folder / 'mlflow.db'}"
        self.client = mlflow.MlflowClient(self.settings.tracking_uri or own)
        experiment = self._experiment(run.folder)
        same = self.client.search_runs([experiment], f"tags.`{_IDENTITY}` = '{run.identity}'")
        if same:
            self.run_id = same[0].info.run_id
            self.client.update_run(self.run_id, status="RUNNING")
        else:
            tags = {_IDENTITY: run.identity}
            created = self.client.create_run(experiment, tags=tags, run_name=run.title)
            self.run_id = created.info.run_id
            self.client.log_dict(self.run_id, run.pipeline, "pipeline.json")
            self.client.log_dict(self.run_id, run.facts, "facts.json")

    def iterated(self, done: IterationDone) -> None:
        """Log the values, and a picture if one is due."""
        if self.client is None:
            return
        self._log(done.scalars(), done.iteration)
        picture = self.settings.picture(done)
        if picture is not None:
            file = f"views/{done.view.name}/{done.iteration:07d}.png"
            self.client.log_image(self.run_id, picture, file)

    def evaluated(self, scored: ViewsScored) -> None:
        """Log the scores."""
        if self.client is not None:
            self._log(scored.scalars(), scored.iteration)

    def ended(self, run: RunEnded) -> None:
        """Set the run's status."""
        if self.client is None:
            return
        if run.error is not None:
            self.client.set_tag(self.run_id, "error", run.error)
        status = "FAILED" if run.error else "FINISHED" if run.finished else "KILLED"
        self.client.set_terminated(self.run_id, status)

    def _experiment(self, folder: Path) -> str:
        """Return the experiment's id; artifacts of a local experiment go into `folder`."""
        known = self.client.get_experiment_by_name(self.settings.experiment)
        if known is not None:
            return str(known.experiment_id)
        artifacts = None if self.settings.tracking_uri else (folder / "artifacts").as_uri()
        return str(self.client.create_experiment(self.settings.experiment, artifacts))

    def _log(self, scalars: Mapping[str, float], iteration: int) -> None:
        now = int(1000 * time.time())
        entities = self.mlflow.entities
        metrics = [entities.Metric(name, x, now, iteration) for name, x in scalars.items()]
        self.client.log_batch(self.run_id, metrics)


@hookimpl
def stereogs_register_observers(register: Register[MlflowObserver]) -> None:
    register("mlflow", MlflowObserver)
