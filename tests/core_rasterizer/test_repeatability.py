"""Training is bit-identical for any number of threads."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from core_rasterizer import Device
from tests.core_rasterizer.training import short_training


def test_five_runs_give_one_digest(device: Device) -> None:
    assert len({short_training(device) for _ in range(5)}) == 1


@pytest.mark.proof
def test_one_thread_and_two_threads_give_one_digest() -> None:
    """In new processes, because PoCL reads its number of threads when it is loaded."""
    units, digests = [], []
    for threads in ("1", "2"):
        settings = {"POCL_MAX_PTHREAD_COUNT": threads, "POCL_CPU_MAX_CU_COUNT": threads}
        output = subprocess.run(
            [sys.executable, "-m", "tests.core_rasterizer.training"],
            env=os.environ | settings,
            check=True,
            capture_output=True,
            text=True,
        ).stdout
        runs = [line.split("\t") for line in output.splitlines()]
        units.append({int(run[0]) for run in runs})
        digests.append([run[1:] for run in runs])
    assert digests[0]
    assert digests[0] == digests[1]
    # One thread was one thread, at least where the settings are understood.
    assert 1 in units[0] or units[0] == units[1]
