"""The folder of an ablation: what is in it, and which runs in it are done.

runs/NAME_DIGEST/       a run folder each, found again by the digest of its pipeline
runs/NAME_DIGEST.yaml   the pipeline that it was started with
runs/NAME_DIGEST.log    what the training printed
ablation.txt, ablation.csv, index.html
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from registry.errors import RunError
from registry.runs.folder import RESULTS, RunFolder
from registry.runs.lock import locked
from registry.runs.results_file import read_results

from ..planning.plan import PlannedRun

RUNS = "runs"


class AblationFolder:
    """Where an ablation's runs and results lie.

    Args:
        path: created when needed.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def run(self, planned: PlannedRun) -> RunFolder:
        """The folder of a run, by its digest; a new name if there is none yet."""
        existing = sorted((self.path / RUNS).glob(f"*_{planned.digest}/"))
        return RunFolder(existing[0] if existing else self.path / RUNS / planned.name)

    def results(self, planned: PlannedRun) -> dict[str, Any]:
        """What a finished run measured; empty if it is not finished, not that pipeline's, or not believed."""
        run = self.run(planned)
        try:
            if not planned.pipeline.wrote(run.pipeline.read_text("utf-8")):
                return {}
            return read_results(run.path / RESULTS)
        except (OSError, UnicodeDecodeError, RunError):
            return {}

    @contextmanager
    def locked(self) -> Iterator[int | None]:
        """Keep a second process out; gives a file descriptor that child processes should inherit.

        The lock lasts until all who hold the descriptor have ended, so that it also covers
        trainings whose starter was killed.

        Raises:
            RunError: another one holds it, or the folder cannot be written.
        """
        try:
            (self.path / RUNS).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RunError(
                f"nothing can be written there: {error.strerror or error}",
                where=str(self.path),
                fix="choose another --out",
            ) from error
        with locked(self.path) as lock:
            yield lock.descriptor
