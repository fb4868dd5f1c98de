"""python -m tests.mutants [COUNT] [AREA ...]: change one place at a time, and run the tests of its file.

COUNT mutants of each area are drawn with a fixed seed. Each runs in a private copy of the tree, with the
limits below, and is killed if a test fails, crashes or hangs. The file build/mutants/record.jsonl stores the
killed ones until their line changes; survivors are tried again, and `EQUIVALENT` lists those that no test can
kill.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import resource
import shutil
import signal
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from hashlib import sha256
from itertools import islice
from multiprocessing import get_context
from pathlib import Path

import cv2  # noqa: F401  imported once for all runs, as the next ones
import pyopencl  # noqa: F401
import pytest
import scipy  # noqa: F401
import torch  # noqa: F401

from tests.mutants.areas import AREAS, ROOT, Area
from tests.mutants.equivalent import EQUIVALENT
from tests.mutants.mutations import Mutant, mutants

COUNT = 24
SEED = 1
CPU_SECONDS, SECONDS, ADDRESSES = 120, 600, 24 << 30
"""Limits of one run of pytest: time of the processor and time, for each test file, and bytes of addresses."""
STATE = ROOT / "build" / "mutants"
KILLED, SURVIVED, INVALID, EQUAL = "killed", "survived", "not tested", "equivalent"
_DOES_NOT_BUILD = "the OpenCL compiler of"
_PASSED, _USAGE, _NOTHING_RAN = 0, 4, 5


def drawn(area: Area, count: int) -> Iterator[tuple[Mutant, tuple[str, ...]]]:
    """Yield the mutants of an area and their tests in a fixed random order, few of each file first."""
    files = dict(area.files())
    ranked = sorted(
        {mutant.key: mutant for file in files for mutant in mutants(ROOT, file)}.values(),
        key=lambda mutant: sha256(f"{SEED} {mutant.key}".encode()).digest(),
    )
    share, taken = math.ceil(2 * count / len(files)), Counter[str]()
    for mutant in ranked:
        if taken[mutant.file] < share and mutant.is_valid(ROOT):
            taken[mutant.file] += 1
            yield mutant, files[mutant.file]


def outcome(mutant: Mutant, tests: tuple[str, ...], options: tuple[str, ...], copy: Path) -> str:
    """Return what the tests say about a mutant; the copy is restored."""
    (copy / mutant.file).write_text(mutant.text(ROOT), "utf-8")
    try:
        status, said = run_tests(tests, options, copy)
    finally:
        shutil.copy2(ROOT / mutant.file, copy / mutant.file)
    if status == _NOTHING_RAN or (mutant.file.endswith(".cl") and _DOES_NOT_BUILD in said):
        return INVALID
    return SURVIVED if status == _PASSED else KILLED


def run_tests(tests: tuple[str, ...], options: tuple[str, ...], copy: Path) -> tuple[int, str]:
    """Run pytest in the copy until the first failure, and return its status and output.

    The process is forked from this one, which has imported what takes long.
    """
    said = copy.parent / "output"
    process = get_context("fork").Process(target=_work, args=(tests, options, copy, said))
    process.start()
    process.join(SECONDS * len(tests))
    with suppress(ProcessLookupError):
        os.killpg(process.pid or 0, signal.SIGKILL)
    process.join()
    text = said.read_text("utf-8", "replace")
    assert process.exitcode not in (_USAGE, None), text
    return process.exitcode, text


def _work(tests: tuple[str, ...], options: tuple[str, ...], copy: Path, said: Path) -> None:
    """Be the process that runs pytest."""
    os.setsid()
    seconds = CPU_SECONDS * len(tests)
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESSES, ADDRESSES))
    with said.open("wb") as file:
        for stream in (1, 2):
            os.dup2(file.fileno(), stream)
    for name in [name for name in sys.modules if name.partition(".")[0] == "tests"]:
        del sys.modules[name]  # they are of the tree, not of the copy
    sys.path[:] = [str(copy), *(path for path in sys.path if Path(path).resolve() != ROOT)]
    os.chdir(copy)
    scratch = said.with_name("scratch")
    shutil.rmtree(scratch, ignore_errors=True)
    scratch.mkdir()
    os.environ |= {
        "PYTHONPATH": str(copy),
        "POCL_CACHE_DIR": str(STATE / "pocl"),
        "TMPDIR": str(scratch),
    }
    tempfile.tempdir = None
    status = pytest.main(["-x", "-q", "-n", "0", "-p", "no:cacheprovider", *options, *tests])
    sys.stdout.flush()
    os._exit(status)


def _not_copied(folder: str, names: list[str]) -> set[str]:
    """Return what tools made."""
    made = {name for name in names if name.startswith(".") or name in ("build", "dist", "runs")}
    return {"__pycache__"} | (made if Path(folder) == ROOT else set())


def run_area(name: str, count: int, copy: Path) -> Counter[str]:
    """Try the mutants of an area, and return how many had each outcome."""
    area, record, counts = AREAS[name], STATE / "record.jsonl", Counter[str]()
    known = {}
    if record.is_file():
        known = {tuple(key): said for *key, said in map(json.loads, record.open(encoding="utf-8"))}
    first = [
        (m, tests) for m, tests in islice(drawn(area, count), count) if m.key not in EQUIVALENT
    ]
    waiting = [tests for m, tests in first if known.get(m.key, SURVIVED) == SURVIVED]
    if waiting:
        every = tuple(dict.fromkeys(test for tests in waiting for test in tests))
        status, output = run_tests(every, area.options, copy)
        if status != _PASSED:
            raise SystemExit(f"the tests fail without a mutant:\n{output}")
    for mutant, tests in drawn(area, count):
        if sum(counts[kind] for kind in (KILLED, SURVIVED, EQUAL)) == count:
            break
        said = EQUAL if mutant.key in EQUIVALENT else known.get(mutant.key, SURVIVED)
        if said == SURVIVED:
            said = outcome(mutant, tests, area.options, copy)
            with record.open("a", encoding="utf-8") as file:
                file.write(json.dumps([*mutant.key, said]) + "\n")
            print(f"{said:14} {mutant.file}:{mutant.line}", flush=True)
        if said == SURVIVED:
            print(f"    {mutant.old.strip()}\n    {mutant.new.strip()}", flush=True)
        counts[said] += 1
    return counts


def main() -> int:
    """Run the areas; return 1 if fewer than 90 % of the mutants that can be killed were."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=__doc__)
    parser.add_argument("count", nargs="?", type=int, default=COUNT, help="mutants of each area")
    parser.add_argument("areas", nargs="*", metavar="AREA", help=", ".join(AREAS))
    arguments = parser.parse_args()
    STATE.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "tree"
        shutil.copytree(ROOT, copy, symlinks=True, ignore=_not_copied)
        rows = {
            name: run_area(name, arguments.count, copy) for name in arguments.areas or list(AREAS)
        }
    rows["all"] = sum(rows.values(), Counter[str]())
    print(f"{'area':22} {'run':>4} {'killed':>7} {'survived':>9} {'equivalent':>11}")
    for name, counts in rows.items():
        tried = counts[KILLED] + counts[SURVIVED]
        print(f"{name:22} {tried:4} {counts[KILLED]:7} {counts[SURVIVED]:9} {counts[EQUAL]:11}")
    return int(rows["all"][KILLED] < 9 * rows["all"][SURVIVED])


if __name__ == "__main__":
    sys.exit(main())
