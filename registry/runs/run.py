"""A run: what was trained, and its folder if it has one."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any
from uuid import uuid4

from ..errors import RunError
from ..toolkit.cache.remote import url_of
from ..training.checkpoint import CHECKPOINT, save_checkpoint
from .folder import RunFolder
from .origin import circumstances, input_digests
from .outputs import finish
from .sources.cameras import cameras_of
from .sources.remote import new_copy
from .trained_scene import TrainedScene


@dataclass(eq=False)
class Run(TrainedScene):
    """A trained scene, during training, after it, or read from its folder.

    Args:
        folder: the run folder; None: in memory only.
        saved_iteration: iteration of the newest checkpoint in the folder.
        photographs: whether the scene has its photographs; without, using one raises why.
    """

    folder: RunFolder | None = None
    saved_iteration: int | None = None
    photographs: bool = True

    @property
    def identity(self) -> str:
        """Unique identifier of the run; "" without a folder."""
        return self.folder.identity if self.folder else ""

    def folder_or_refuse(self) -> RunFolder:
        """Return the folder, or raise a RunError if the run is in memory only."""
        if self.folder is None:
            raise RunError("the run is in memory only", fix="save it first: run.save(folder)")
        return self.folder

    def save(self, folder: str | os.PathLike[str]) -> Path:
        """Write the run folder that training with `out=folder` would have written, with one checkpoint.

        Raises:
            RunError: the run has a folder already, or this one is not empty.
        """
        if self.folder is not None:
            raise RunError(
                "the run has a folder already",
                where=str(self.folder.path),
                fix="copy that folder; a run folder can be moved",
            )
        self.keep_in(Path(folder).expanduser())
        kept_in = self.folder_or_refuse()
        if self.finished:
            with kept_in.training():
                finish(self, kept_in)
        return kept_in.path

    def keep_in(self, path: Path) -> None:
        """Create the run folder with a checkpoint; later files go there too. See `RunFolder.create`."""
        folder = RunFolder(new_copy(url) if (url := url_of(path)) else path)
        provenance = {
            "run": uuid4().hex,
            "seed": self.pipeline.training.seed,
            "folder": str(Path.cwd()),
            "folder_from_run": os.path.relpath(Path.cwd().resolve(), folder.path.resolve()),
            **circumstances(self.pipeline, self.engine_model.engine),
            **({"edits": self.edits} if self.edits else {}),
            "resumed": [],
        }

        def fill(folder: RunFolder) -> None:
            folder.write_cameras(cameras_of(self.scene))
            folder.write_initialization(self.initialization, self.pictures)
            checkpoint = replace(self.checkpoint(), run=folder.identity)
            save_checkpoint(checkpoint, folder.folder(CHECKPOINT))
            for line in self.metrics:
                folder.append_metrics(line)

        digests = input_digests(self.scene, self.pipeline)
        folder.create(self.pipeline_text, provenance, digests, fill)
        if folder.remote is not None:
            folder.remote.take()
            folder.remote.send()
        self.folder, self.saved_iteration = folder, self.iteration

    def check_folder(self) -> None:
        """Refuse to write into a folder that was moved or removed; the run is kept in a new one beside it.

        Raises:
            RunError: names the new folder.
        """
        if self.folder is None or self.folder.pipeline.is_file():
            return
        lost, self.folder = self.folder.path, None
        names = (lost.with_name(f"{lost.name}-kept-{number}") for number in count(1))
        self.keep_in(kept := next(path for path in names if not path.exists()))
        raise RunError(
            f"the run folder was moved or removed during training; iteration {self.iteration} is kept "
            f"in {kept}",
            where=str(lost),
            fix=f"stereogs resume {kept}",
        )

    def add_metrics(self, line: dict[str, Any]) -> None:
        """Add a line of metrics, also to the folder."""
        self.metrics.append(line)
        self.check_folder()
        if self.folder is not None:
            self.folder.append_metrics(line)

    def save_checkpoint(self) -> None:
        """Write a checkpoint to the folder, unless its newest is of this iteration."""
        self.check_folder()
        if self.folder is not None and self.saved_iteration != self.iteration:
            save_checkpoint(self.checkpoint(), self.folder.folder(CHECKPOINT))
            self.saved_iteration = self.iteration
            if self.folder.remote is not None:
                self.folder.remote.try_to_send()
