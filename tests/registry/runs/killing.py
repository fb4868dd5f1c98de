"""Train in child processes, kill them with SIGKILL, resume them, and print how each ended.

    python -m tests.registry.runs.killing COUNT SEED FOLDER

A program of its own, because its children are forked: it imports torch once, and opens no OpenCL device.
Each line of its output is a JSON object about one run; the first is the run that nobody kills.
"""

from __future__ import annotations

import json
import os
import random
import signal
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any
from unittest import mock

import safetensors.torch

import registry.runs.training_run  # so that no child needs to
from tests.host import main

PIPELINE = """\
name: killed
scene: {use: procedural, width: 64, height: 48, train_views: 3, test_views: 1}
initializer: {use: random, count: 300}
modifiers: [{use: dropout, rate: 0.2}]
densification: {use: gradient_threshold, start: 5, stop: 30, every: 5}
opacity: {use: gradient_aware_decay, base: 0.99, sensitivity: 0.5, scope: visible, start: 5}
metrics: [psnr]
exporters: [ply]
training: {iterations: 40, sh_degree: 1, sh_every: 20, checkpoint_every: 4, max_gaussians: 1000}
"""

Call = Callable[..., Any]
PATIENCE = 120.0
"""Seconds that a run may take until its folder exists."""


class Moments:
    """Counts the times before and after each flush, rename and write of a process; kills it at one of them.

    Args:
        fatal: the number of the moment to die in, from 0 on; None: in none.
    """

    def __init__(self, fatal: int | None) -> None:
        self.count, self._fatal = 0, fatal

    def watch(self) -> None:
        """From now on."""
        os.fsync = self._around(os.fsync)
        Path.rename = self._around(Path.rename)  # type: ignore[method-assign]
        Path.replace = self._around(Path.replace)  # type: ignore[method-assign]
        torn = self._half_way(safetensors.torch.save_file)
        mock.patch("registry.training.checkpoint.save_file", torn).start()

    def _around(self, call: Call) -> Call:
        def watched(*arguments: Any, **options: Any) -> Any:
            self._moment()
            answer = call(*arguments, **options)
            self._moment()
            return answer

        return watched

    def _half_way(self, save: Call) -> Call:
        def watched(tensors: Any, file: Path) -> None:
            save(tensors, file)
            if self.count == self._fatal:
                os.truncate(file, file.stat().st_size // 2)
            self._moment()

        return watched

    def _moment(self) -> None:
        if self.count == self._fatal:
            os.kill(os.getpid(), signal.SIGKILL)
        self.count += 1


def start(arguments: Sequence[str], log: Path, moments: Moments) -> int:
    """Run the command line in a child process; return its process id."""
    process = os.fork()
    if process:
        return process
    status = 70
    try:
        with log.open("ab", buffering=0) as file:
            os.dup2(file.fileno(), 1)
            os.dup2(file.fileno(), 2)
        moments.watch()
        status = main(arguments)
        log.with_suffix(".moments").write_text(str(moments.count))
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


def wait_for(folder: Path) -> None:
    """Wait until a run folder exists; an earlier run has nothing to lose."""
    end = time.monotonic() + PATIENCE
    while not folder.exists() and time.monotonic() < end:
        time.sleep(0.002)


def ended(process: int) -> int:
    """Wait for a child; return its exit status, negative for a signal."""
    return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])


def described(folder: Path) -> dict[str, Any]:
    """Return the contents of a finished run folder that must not depend on kills."""
    results = json.loads((folder / "results.json").read_text())
    lines = (folder / "metrics.jsonl").read_text().splitlines()
    return {
        "hash": results["hash"],
        "test": results["test"],
        "iterations": [json.loads(line)["iteration"] for line in lines],
        "leftovers": [path.name for path in folder.parent.rglob("*.partial")],
    }


def killed(number: int, random_: random.Random, folder: Path, whole: dict[str, Any]) -> Any:
    """Kill a run once, after some time or within a save, and resume it to its end."""
    place = folder / str(number)
    place.mkdir()
    out, log = place / "run", place / "log.txt"
    train = ["train", str(folder / "killed.yaml"), "--out", str(out)]
    by_clock = number % 2 == 0
    fatal = None if by_clock else random_.randrange(whole["moments"])
    process = start(train, log, Moments(fatal))
    if by_clock:
        wait_for(out)
        time.sleep(random_.uniform(0, whole["seconds"]))
        os.kill(process, signal.SIGKILL)
    first = ended(process)
    left = sorted(path.name for path in out.glob("checkpoint/iteration-*"))
    again = ["resume", str(out)] if out.exists() else train
    status = ended(start(again, log, Moments(None)))
    return {
        "number": number,
        "within": "any moment" if by_clock else f"write {fatal}",
        "killed": first == -signal.SIGKILL,
        "left": left,
        "verb": again[0],
        "status": status,
        **(described(out) if status == 0 else {"log": log.read_text()}),
    }


def run(count: int, seed: int, folder: Path) -> None:
    """Kill `count` runs, one after the other."""
    (folder / "killed.yaml").write_text(PIPELINE)
    out, log = folder / "whole" / "run", folder / "whole.txt"
    train = ["train", str(folder / "killed.yaml"), "--out", str(out)]
    process = start(train, log, Moments(None))
    wait_for(out)
    begin = time.monotonic()
    if ended(process):
        raise SystemExit(log.read_text())
    whole = {"seconds": time.monotonic() - begin}
    whole["moments"] = int(log.with_suffix(".moments").read_text())
    print(json.dumps({**whole, **described(out)}), flush=True)
    random_ = random.Random(seed)
    for number in range(count):
        print(json.dumps(killed(number, random_, folder, whole)), flush=True)


if __name__ == "__main__":
    assert registry.runs.training_run
    run(int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3]))
