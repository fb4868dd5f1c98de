"""The output folder of an ablation or bench.

runs/NAME_DIGEST/       a run folder; the digest identifies its pipeline
runs/NAME_DIGEST.yaml   the pipeline that was trained
runs/NAME_DIGEST.log    the output of the training
shards/I_OF_N/          the lock of a process with --shard
peers/PEER/             the lock and the heartbeat of a process with --shared
claims/DIGEST.N/        who trains a run, see queue.py
ablation.txt, ablation.tex, ablation.csv, ablation_means.csv, index.html
"""

from __future__ import annotations

import os
import re
import socket
import uuid
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from registry import RunError
from registry.runners import TrainingTask
from registry.runs.folder import RESULTS, RunFolder
from registry.runs.results import read_results
from registry.system.lock import locked
from registry.toolkit.cache.remote import url_of

from ..planning.plan import PlannedRun

RUNS, SHARDS, PEERS = "runs", "shards", "peers"
Run = TypeVar("Run")


class Shard(NamedTuple):
    """Part `number`, from 1, of `parts` parts of the runs."""

    number: int
    parts: int

    def of(self, runs: Sequence[Run]) -> Sequence[Run]:
        """Return every `parts`-th run: neighbours, which take about as long, are in different parts."""
        return runs[self.number - 1 :: self.parts]

    @property
    def path(self) -> Path:
        """Its folder in the output folder."""
        return Path(SHARDS, f"{self.number}_of_{self.parts}")


class Peer(NamedTuple):
    """A process that shares the folder with others.

    Args:
        host: name of its machine, for people.
        machine: the same for all processes that see each other's locks.
        process: unique on its machine.
    """

    host: str
    machine: str
    process: str

    @classmethod
    def here(cls) -> Peer:
        """Return this process."""
        try:  # containers of one machine have the same, and the same locks
            boot = Path("/proc/sys/kernel/random/boot_id").read_text("utf-8")
        except OSError:
            boot = f"{socket.gethostname()} {uuid.getnode()}"
        host = re.sub(r"[^A-Za-z0-9.-]+", "-", socket.gethostname())
        process = f"{os.getpid()}-{uuid.uuid4().hex[:4]}"
        return cls(host, sha256(boot.encode()).hexdigest()[:8], process)

    @classmethod
    def named(cls, name: str) -> Peer:
        """Return the peer with a name."""
        return cls(*name.split("_"))

    @property
    def name(self) -> str:
        """Unique among all peers."""
        return "_".join(self)

    @property
    def path(self) -> Path:
        """Its folder in the output folder."""
        return Path(PEERS, self.name)


class ExperimentFolder:
    """An output folder, which is created when needed."""

    def __init__(self, path: Path) -> None:
        if url := url_of(path):
            raise RunError(
                "the folder of an experiment is local; runs of `train` and scenes may be remote",
                where=url,
                fix="give a local --out, and copy the folder with the tools of the remote file system",
            )
        self.path = path

    def run(self, planned: PlannedRun) -> RunFolder:
        """Return the run folder with the digest, or a new one."""
        path = self.path / RUNS / planned.name
        if path.is_dir():  # a search lists all runs
            return RunFolder(path)
        existing = sorted((self.path / RUNS).glob(f"*_{planned.digest}/"))
        return RunFolder(existing[0] if existing else path)

    def results(self, planned: PlannedRun) -> dict[str, Any]:
        """Return the results of a finished run; empty if unfinished, invalid or of another pipeline."""
        run = self.run(planned)
        try:
            if not planned.pipeline.wrote(run.pipeline.read_text("utf-8")):
                return {}
            return read_results(run.path / RESULTS)
        except (OSError, UnicodeDecodeError, RunError):
            return {}

    def task(self, planned: PlannedRun, device: str | None = None) -> TrainingTask:
        """Return the task that trains a run in its folder, with a log next to it."""
        path = self.run(planned).path
        log = path.with_name(f"{path.name}.log")
        return TrainingTask(planned.pipeline.to_yaml(), path, log, device)

    def keep(self, planned: PlannedRun) -> bool:
        """Return whether the run is finished; its folder keeps the results."""
        return bool(self.results(planned))

    @contextmanager
    def locked(self, part: Shard | Peer | None = None) -> Iterator[int | None]:
        """Lock the folder against other processes; yield a file descriptor for child processes to inherit.

        Processes with different shards or peers may use the folder at the same time, one without either only
        alone. If this process is killed, the lock is held until every child has closed the descriptor, so it
        also covers trainings whose parent was killed.

        Raises:
            RunError: another process holds the lock, or the folder is not writable.
        """
        own = self.path if part is None else self.path / part.path
        try:
            (self.path / RUNS).mkdir(parents=True, exist_ok=True)
            own.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RunError(
                f"the folder is not writable: {error.strerror or error}",
                where=str(self.path),
                fix="choose another --out",
            ) from error
        with ExitStack() as held:
            if part is None:
                for kind in (SHARDS, PEERS):
                    for other in sorted((self.path / kind).glob("*_*/")):
                        held.enter_context(locked(other))
            else:
                with locked(self.path):
                    pass
            yield held.enter_context(locked(own)).descriptor
