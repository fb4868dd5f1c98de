"""`tensorboard`: losses, counts, scores and pictures as TensorBoard event files."""

from __future__ import annotations

import json
from typing import Any

from registry import Observer, Register, hookimpl
from registry.events import IterationDone, RunEnded, RunStarted, ViewsScored
from registry.toolkit import LoggerSettings, optional_module


class TensorBoardObserver(Observer[LoggerSettings]):
    """Event files for `tensorboard --logdir runs`; requires the extra `tensorboard`."""

    writer: Any = None

    def started(self, run: RunStarted) -> None:
        """Open an event file; a resumed run drops earlier events of the iterations it repeats."""
        if run.folder is None:
            return
        module = optional_module(
            "torch.utils.tensorboard", "pip install 'stereogs-plugins[tensorboard]'"
        )
        purge = run.iteration + 1 if run.resumed else None
        self.writer = module.SummaryWriter(str(run.folder), purge_step=purge)
        if not run.resumed:
            for title, values in (("pipeline", run.pipeline), ("facts", run.facts)):
                indented = json.dumps(values, indent=1).replace("\n", "\n    ")
                self.writer.add_text(title, f"    {indented}", 0)  # a Markdown code block

    def iterated(self, done: IterationDone) -> None:
        """Add a point to each curve, and a picture if one is due."""
        if self.writer is None:
            return
        for name, value in done.scalars().items():
            self.writer.add_scalar(name, value, done.iteration)
        picture = self.settings.picture(done)
        if picture is not None:
            name = f"views/{done.view.name}"
            self.writer.add_image(name, picture, done.iteration, dataformats="HWC")

    def evaluated(self, scored: ViewsScored) -> None:
        """Add the scores."""
        if self.writer is not None:
            for name, value in scored.scalars().items():
                self.writer.add_scalar(name, value, scored.iteration)

    def ended(self, run: RunEnded) -> None:
        """Close the file; write the error of a failed run."""
        if self.writer is None:
            return
        if run.error is not None:
            self.writer.add_text("error", run.error, run.iteration)
        self.writer.close()


@hookimpl
def stereogs_register_observers(register: Register[TensorBoardObserver]) -> None:
    register("tensorboard", TensorBoardObserver)
