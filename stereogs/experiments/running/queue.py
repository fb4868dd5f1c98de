"""The trainings that wait for a place: of one process, or shared by processes of several machines."""

from __future__ import annotations

import json
import time
from collections.abc import Hashable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from shutil import rmtree
from typing import Generic, Literal, NamedTuple, TypeVar

from registry import RunError
from registry.system.files import new_folder, write_json, write_text
from registry.system.lock import locked

from ..planning.plan import PlannedRun
from .folder import ExperimentFolder, Peer
from .worker import missing_paths

Planned = TypeVar("Planned", bound=Hashable)
"""A training that is planned, for example a `PlannedRun`."""
State = Literal["training", "stopped", "failed", "not here"]
CLAIMS = "claims"
BEAT = "heartbeat"
_CLAIM = "claim.json"
BEAT_SECONDS = 5.0
"""Time between two heartbeats of a process."""
STALE_SECONDS = 60.0
"""A process on another machine whose heartbeat does not change for so long is dead."""
LOOK_SECONDS = 2.0
"""Time between two looks at the claims of others while nothing is free."""


class Queue(Generic[Planned]):
    """Trainings in order, for this process alone."""

    def __init__(self, waiting: Sequence[Planned]) -> None:
        self._waiting = dict.fromkeys(waiting)
        self._settled: list[tuple[Planned, str]] = []

    def __len__(self) -> int:
        return len(self._waiting)

    def take(self) -> Planned | None:
        """Remove and return the next training; None if none is free at present."""
        planned = next(iter(self._waiting), None)
        if planned is not None:
            del self._waiting[planned]
        return planned

    def clear(self) -> None:
        """Remove all that wait."""
        self._waiting.clear()

    def ended(self, planned: Planned, state: State | None, why: str = "") -> bool:
        """Note the end of a training that was taken; state None: it has results.

        Returns:
            False if it waits again, for another machine.
        """
        return True

    def take_settled(self) -> list[tuple[Planned, str]]:
        """Remove and return the trainings that ended elsewhere, and their errors, empty after success."""
        settled, self._settled = self._settled, []
        return settled

    def lost(self) -> Sequence[Planned]:
        """Return the trainings that other processes have taken over; to be called often."""
        return ()


class Claim(NamedTuple):
    """The newest claim of a run: its number, from 1, and what its file says."""

    number: int
    peer: str
    state: State
    why: str


class SharedQueue(Queue[PlannedRun]):
    """Runs that processes on several machines take from one folder.

    A process takes a run by creating the folder `claims/DIGEST.N`, which only one can. N counts up: the
    holder of the highest number trains, and N + 1 may be claimed only if the holder of N has ended it or is
    dead. A process on the same machine is dead if the system has freed its lock, another one if its heartbeat
    has not changed for `STALE_SECONDS` of this process' clock; clocks are never compared.

    Args:
        peer: this process.
    """

    def __init__(self, waiting: Sequence[PlannedRun], folder: ExperimentFolder, peer: Peer) -> None:
        super().__init__(waiting)
        self._folder, self._peer = folder, peer
        self._claims = folder.path / CLAIMS
        self._claims.mkdir(parents=True, exist_ok=True)
        self._before = {(digest, claim.number) for digest, claim in self._newest().items()}
        self._mine: dict[PlannedRun, int] = {}
        self._not_here: dict[PlannedRun, str] = {}
        self._absent: set[Path] = set()
        self._seen: dict[str, tuple[str, float]] = {}
        self._look = self._beat = 0.0
        self._beats = 0

    def take(self) -> PlannedRun | None:
        """Claim and return the next free run; runs that others have finished are settled."""
        if time.monotonic() < self._look:
            return None
        newest = self._newest()
        for planned in [*self._waiting]:
            claim = newest.get(planned.digest)
            if not self._is_free(planned, claim):
                continue
            if not self._claim(planned, claim.number + 1 if claim else 1):
                continue
            del self._waiting[planned]
            if self._folder.keep(planned):
                self.ended(planned, None)
                self._settled.append((planned, ""))
            elif absent := self._absent & set(missing_paths(planned.pipeline)):
                self.ended(planned, "not here", f"{min(absent)} is missing")
            else:
                return planned
        self._look = time.monotonic() + LOOK_SECONDS
        return None

    def ended(self, planned: PlannedRun, state: State | None, why: str = "") -> bool:
        """Release the claim; other processes see why."""
        number = self._mine.pop(planned)
        if state is None:
            for path in self._claims.glob(f"{planned.digest}.*"):
                rmtree(path, ignore_errors=True)
            return True
        if self._path(planned, number).exists():  # otherwise another process has finished it
            self._write(self._path(planned, number), state, why)
        if state == "not here":
            self._absent |= set(missing_paths(planned.pipeline))
            self._not_here[planned] = why
            self._waiting[planned] = None
        return state != "not here"

    def lost(self) -> Sequence[PlannedRun]:
        """Write the heartbeat; return runs that others took over while this process was suspended."""
        now = time.monotonic()
        if now < self._beat:
            return ()
        self._beat, self._beats = now + BEAT_SECONDS, self._beats + 1
        with suppress(OSError):  # a full disk; if it lasts, others take over
            write_text(self._folder.path / self._peer.path / BEAT, f"{self._beats}\n")
        lost = [
            run
            for run, number in self._mine.items()
            if self._path(run, number + 1).exists() or not self._path(run, number).exists()
        ]
        for run in lost:
            del self._mine[run]
            self._waiting[run] = None
        return lost

    def close(self) -> None:
        """Release all claims."""
        for planned in [*self._mine]:
            self.ended(planned, "stopped")

    def _is_free(self, planned: PlannedRun, claim: Claim | None) -> bool:
        """Return whether this process may claim a run; settle it if nobody will train it."""
        if planned in self._not_here:
            if claim is None or not self._others(planned, claim):
                finished = self._folder.keep(planned)
                self._settle(planned, "" if finished else self._not_here[planned])
            return False
        if claim is None:
            return True
        if claim.state == "training":
            return not self._alive(claim.peer)
        if claim.state == "failed" and (planned.digest, claim.number) not in self._before:
            self._settle(planned, f"{claim.why} ({claim.peer})")
            return False
        return True

    def _settle(self, planned: PlannedRun, failure: str) -> None:
        self._waiting.pop(planned, None)
        self._settled.append((planned, failure))

    def _others(self, planned: PlannedRun, claim: Claim) -> bool:
        """Return whether a living process has not yet said that it lacks the data of a run."""
        without = {self._peer.name}
        for number in range(1, claim.number + 1):
            found = _read(self._path(planned, number))
            if found and found.state == "not here":
                without.add(found.peer)
        peers = {path.name for path in (self._folder.path / self._peer.path).parent.iterdir()}
        return any(self._alive(peer) for peer in peers - without)

    def _alive(self, name: str) -> bool:
        peer = Peer.named(name)
        place = self._folder.path / peer.path
        if peer.machine == self._peer.machine:
            return _is_locked(place)
        try:
            beat = (place / BEAT).read_text("utf-8")
        except OSError:
            beat = ""
        now = time.monotonic()
        last, since = self._seen.get(name, ("unknown", now))
        if beat != last:
            since = now
        self._seen[name] = beat, since
        return place.is_dir() and now - since < STALE_SECONDS

    def _newest(self) -> dict[str, Claim]:
        """Return the newest claim of each run by digest."""
        numbers: dict[str, int] = {}
        for path in self._claims.iterdir():
            digest, _, number = path.name.partition(".")
            if number.isdecimal():
                numbers[digest] = max(numbers.get(digest, 0), int(number))
        found = {d: _read(self._claims / f"{d}.{number}") for d, number in numbers.items()}
        return {digest: claim for digest, claim in found.items() if claim is not None}

    def _claim(self, planned: PlannedRun, number: int) -> bool:
        """Create a claim; return False if another process was faster."""
        path = self._path(planned, number)
        try:
            with new_folder(path) as inside:
                self._write(inside, "training")
        except OSError:
            if path.exists():
                return False
            raise
        self._mine[planned] = number
        return True

    def _write(self, claim: Path, state: State, why: str = "") -> None:
        write_json(claim / _CLAIM, {"peer": self._peer.name, "state": state, "why": why})

    def _path(self, planned: PlannedRun, number: int) -> Path:
        return self._claims / f"{planned.digest}.{number}"


@contextmanager
def shared(
    waiting: Sequence[PlannedRun], folder: ExperimentFolder, peer: Peer
) -> Iterator[SharedQueue]:
    """Yield a shared queue while this process has locked its peer; release its claims after the block.

    Raises:
        RunError: a fallback replaces a prior here, so that machines may train different pipelines.
    """
    for run in waiting:
        for prior in run.pipeline.items["priors"]:
            if prior.fallback:
                raise RunError(
                    f"with --shared no prior may be replaced, but {prior.fallback}",
                    where=str(prior.place),
                    fix="put the model files on all machines, or name the fallback in the pipeline",
                )
    queue = SharedQueue(waiting, folder, peer)
    try:
        yield queue
    finally:
        queue.close()
        rmtree(folder.path / peer.path, ignore_errors=True)


def _read(claim: Path) -> Claim | None:
    """Return what a claim says; None if it was removed."""
    try:
        content = json.loads((claim / _CLAIM).read_text("utf-8"))
    except OSError:
        return None
    number = int(claim.name.partition(".")[2])
    return Claim(number, content["peer"], content["state"], content["why"])


def _is_locked(folder: Path) -> bool:
    """Return whether a process of this machine holds the lock of a folder."""
    if not folder.is_dir():
        return False
    try:
        with locked(folder):
            return False
    except RunError:
        return True
