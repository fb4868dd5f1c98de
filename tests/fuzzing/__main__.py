"""python -m tests.fuzzing COUNT [FORMAT ...]: read COUNT damaged files of each format, on all cores.

The folder .fuzz stores finished shares of a thousand files; the same command continues from there. It also
stores each failure with the number that reproduces it; the exit status is then 1.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from pathlib import Path

from tests.fuzzing.formats import TARGETS
from tests.fuzzing.fuzz import Tally
from tests.fuzzing.worker import work

SHARE = 1000
Share = tuple[str, int, int]
"""A format, the first number, and the number after the last."""


class State:
    """Finished shares, in a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.done: dict[Share, tuple[int, int, int]] = {}
        self._file = folder / "done.jsonl"
        folder.mkdir(exist_ok=True)
        if self._file.is_file():
            for line in self._file.read_text("utf-8").splitlines():
                name, first, stop, *counts = json.loads(line)
                self.done[name, first, stop] = (counts[0], counts[1], counts[2])

    def add(self, share: Share, tally: Tally) -> None:
        """Save the result of a share."""
        counts = (tally.accepted, tally.refused, len(tally.failures))
        self.done[share] = counts
        with self._file.open("a", encoding="utf-8") as file:
            file.write(json.dumps([*share, *counts]) + "\n")
        for number, said in tally.failures.items():
            self._fail(share[0], number, said)

    def _fail(self, name: str, number: int, said: str) -> None:
        place = self.folder / f"failed-{name.replace(' ', '-')}-{number}.txt"
        place.write_text(said, "utf-8")
        print(f"FAILED  {name} {number}: {said.strip().splitlines()[-1]}  ({place})", flush=True)

    def ended_while_reading(self) -> list[tuple[str, int]]:
        """Return the inputs that crashed processes were reading."""
        found = []
        for note in sorted(self.folder.glob("*.reading")):
            name, _, number = note.read_text("utf-8").partition("\n")
            note.unlink()
            if number:
                found.append((name, int(number)))
        return found


def shares(names: list[str], count: int) -> Iterator[Share]:
    """Return all shares, alternating between formats, so that a partial run covers each format."""
    for first in range(0, count, SHARE):
        for name in names:
            yield name, first, min(first + SHARE, count)


def run(state: State, wanted: Iterable[Share], total: int) -> None:
    """Run all shares; if a process crashes, find the input that it was reading, and repeat the rest."""
    queue, began, at_first = deque(wanted), time.monotonic(), len(state.done)
    cores = os.cpu_count() or 1
    while queue:
        running: dict[Future[Tally], Share] = {}
        with ProcessPoolExecutor(cores, get_context("spawn")) as pool:
            try:
                while queue or running:
                    while queue and len(running) < 2 * cores:
                        share = queue.popleft()
                        running[pool.submit(work, *share, state.folder)] = share
                    for future in wait(running, return_when=FIRST_COMPLETED).done:
                        state.add(running[future], future.result())
                        del running[future]
                    _tell(state, total, len(state.done) - at_first, time.monotonic() - began)
            except BrokenProcessPool:
                queue.extendleft(running.values())
        for name, number in state.ended_while_reading():
            state.add((name, number, number + 1), _alone(name, number, state.folder))
            queue = deque(part for share in queue for part in _without(share, name, number))


def _alone(name: str, number: int, folder: Path) -> Tally:
    """Read one input in a separate process; a crash in the pool ends other processes too."""
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        try:
            return pool.submit(work, name, number, number + 1, folder).result()
        except BrokenProcessPool:
            return Tally(failures={number: "the process ended: a crash, or more than a minute"})


def _without(share: Share, name: str, number: int) -> list[Share]:
    """Return the share, or its parts on both sides of a number."""
    own, first, stop = share
    if own != name or not first <= number < stop:
        return [share]
    parts = [(own, first, number), (own, number + 1, stop)]
    return [part for part in parts if part[1] < part[2]]


def _tell(state: State, total: int, lately: int, seconds: float) -> None:
    inputs = sum(sum(counts) for counts in state.done.values())
    failed = sum(counts[2] for counts in state.done.values())
    minutes = (total - inputs) / max(1, lately * SHARE) * seconds / 60
    print(
        f"{100 * inputs // total:3d} %  {inputs:,} of {total:,}, about {minutes:.0f} min left, "
        f"{failed} failures",
        flush=True,
    )


def main() -> int:
    """Fuzz; return 0 if nothing failed."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzzing", description=__doc__)
    parser.add_argument("count", type=int, help="damaged files of each format")
    parser.add_argument("formats", nargs="*", metavar="FORMAT", help=", ".join(TARGETS))
    parser.add_argument("--state", type=Path, default=Path(".fuzz"), metavar="DIR")
    arguments = parser.parse_args()
    names = arguments.formats or list(TARGETS)
    state = State(arguments.state)
    wanted = list(shares(names, arguments.count))
    run(state, [share for share in wanted if share not in state.done], arguments.count * len(names))
    for name in names:
        rows = [counts for share, counts in state.done.items() if share[0] == name]
        accepted, refused, failed = (sum(column) for column in zip(*rows, strict=True))
        print(f"{name}: {accepted:,} still valid, {refused:,} refused, {failed} failures")
    return 1 if any(arguments.state.glob("failed-*")) else 0


if __name__ == "__main__":
    sys.exit(main())
