"""`wandb`: a Weights & Biases run, stored in the run folder until it is synced."""

from __future__ import annotations

import os
from typing import Any, Literal

from registry import Observer, Register, hookimpl
from registry.events import IterationDone, RunEnded, RunStarted, ViewsScored
from registry.toolkit import LoggerSettings, optional_module


class WandbSettings(LoggerSettings):
    project: str = "stereogs"
    """Name of the project."""
    mode: Literal["offline", "online"] = "offline"
    """"offline" only writes files, for `wandb sync`; "online" uploads at once."""


class WandbObserver(Observer[WandbSettings]):
    """A Weights & Biases run, offline by default; requires the extra `wandb`."""

    wandb: Any = None
    run: Any = None

    def started(self, run: RunStarted) -> None:
        """Start a run, or continue the one with the same identity."""
        if run.folder is None:
            return
        if self.settings.mode == "offline":
            # By default wandb sends its own error reports over the network.
            os.environ.setdefault("WANDB_ERROR_REPORTING", "false")
        self.wandb = optional_module("wandb", "pip install 'stereogs-plugins[wandb]'")
        self.run = self.wandb.init(
            project=self.settings.project,
            name=run.title,
            id=run.identity,
            resume="allow",
            config={"pipeline": run.pipeline, "facts": run.facts},
            mode=self.settings.mode,
            dir=str(run.folder),
            settings=self.wandb.Settings(silent=True, console="off", save_code=False),
        )

    def iterated(self, done: IterationDone) -> None:
        """Log the values, and a picture if one is due."""
        if self.run is None:
            return
        values: dict[str, Any] = {**done.scalars()}
        picture = self.settings.picture(done)
        if picture is not None:
            values[f"views/{done.view.name}"] = self.wandb.Image(picture)
        self.run.log(values, step=done.iteration)

    def evaluated(self, scored: ViewsScored) -> None:
        """Log the scores."""
        if self.run is not None:
            self.run.log(scored.scalars(), step=scored.iteration)

    def ended(self, run: RunEnded) -> None:
        """Finish the run, with exit code 1 if it failed."""
        if self.run is None:
            return
        if run.error is not None:
            self.run.summary["error"] = run.error
        self.run.finish(exit_code=0 if run.error is None else 1)


@hookimpl
def stereogs_register_observers(register: Register[WandbObserver]) -> None:
    register("wandb", WandbObserver)
