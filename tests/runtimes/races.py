"""python -m tests.runtimes.races: all kernels below oclgrind, which reports races and bad accesses.

oclgrind (Price and McIntosh-Smith, IWOCL 2015) interprets kernels, so the scenes are small. It is fetched
into build/runtimes the first time; where that is impossible, nothing is tested. Exit status 1 on any report.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

from tests.runtimes.catalog import LIBRARIES, selected
from tests.runtimes.fetching import FOLDER, ROOT, Unavailable, unpacked

PARTS = ("engine", "matching")
_SECONDS = 1800
_REPORT = 2000
"""Characters of a report that are printed."""


def simulator() -> dict[str, str]:
    """Environment in which OpenCL runs in oclgrind.

    Raises:
        Unavailable: it cannot be fetched.
    """
    folder = unpacked("oclgrind", debian=("oclgrind",))
    (headers,) = (folder / LIBRARIES / "oclgrind").iterdir()
    return {
        **selected(folder, Path("usr", "lib", "oclgrind", "liboclgrind-rt-icd.so"), LIBRARIES),
        "STEREOGS_DEVICE": "oclgrind",
        "OCLGRIND_PCH_DIR": str(headers),
        "OCLGRIND_DATA_RACES": "1",
        "OCLGRIND_COMPUTE_UNITS": "2",
        "OCLGRIND_MAX_ERRORS": "20",
        # It does not know what its compiler makes of these two.
        "OCLGRIND_BUILD_OPTIONS": "-Drestrict= -D__builtin_sqrtf=sqrt",
        "PYOPENCL_NO_CACHE": "1",
    }


def reports(variant: str, part: str, *removed: str) -> str:
    """What oclgrind reports of one part; empty if nothing.

    Args:
        removed: barriers to leave out, see `race_scenes`.

    Raises:
        Unavailable: oclgrind cannot be fetched.
        RuntimeError: the scenes did not run to their end.
    """
    log = FOLDER / f"races-{variant}-{part}{'-removed' if removed else ''}.txt"
    environment = {**selected_environment(), "OCLGRIND_LOG": str(log)}
    log.unlink(missing_ok=True)
    command = [sys.executable, "-m", "tests.runtimes.race_scenes", variant, part, *removed]
    result = subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=_SECONDS
    )
    if "finished on" not in result.stdout or "Oclgrind" not in result.stdout:
        raise RuntimeError(
            f"{' '.join(command[1:])} failed:\n{result.stdout}{result.stderr[-3000:]}"
        )
    return log.read_text("utf-8", "replace") if log.exists() else ""


def selected_environment() -> dict[str, str]:
    """The environment of this process with `simulator`."""
    return {**os.environ, **simulator()}


def main() -> int:
    """Run every part with both variants; return 1 if oclgrind reports anything."""
    try:
        simulator()
    except Unavailable as reason:
        print(f"races: skipped, oclgrind cannot be fetched: {reason}")
        return 0
    failed = False
    for variant in ("gpu", "cpu"):
        for part in PARTS:
            start = time.monotonic()
            found = reports(variant, part)
            failed |= bool(found)
            verdict = f"FAILED\n{found[:_REPORT]}" if found else "no race, no access out of bounds"
            print(
                f"{part}, {variant} kernels: {verdict} ({time.monotonic() - start:.0f} s)",
                flush=True,
            )
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
