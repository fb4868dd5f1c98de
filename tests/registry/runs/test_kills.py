"""Runs that are killed with SIGKILL at any time, also within a save, and resumed, end in the same bits.

KILLS=50 kills so many (`make kills`), each time other ones.
"""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
FEW = 3


@pytest.mark.proof
def test_killed_and_resumed_runs_end_in_the_same_bits(tmp_path: Path) -> None:
    count = int(os.environ.get("KILLS", FEW))
    seed = 1 if count == FEW else random.randrange(2**32)
    environment = {name: value for name, value in os.environ.items() if name != "STEREOGS_PLUGINS"}
    command = [sys.executable, "-m", "tests.registry.runs.killing", str(count), str(seed)]
    with subprocess.Popen(
        [*command, str(tmp_path)], cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        whole = json.loads(process.stdout.readline())
        same = ("hash", "test", "iterations", "leftovers")
        wrong, deaths, within = [], 0, 0
        for line in process.stdout:
            run = json.loads(line)
            print(
                run["number"], "killed" if run["killed"] else "too late", run["within"], run["left"]
            )
            deaths += run["killed"]
            within += run["killed"] and run["within"] != "any moment"
            if any(run.get(key) != whole[key] for key in same):
                wrong.append(run)
    assert process.returncode == 0
    print(f"{count} runs, {deaths} killed, {within} of them within a write; seed {seed}")
    assert wrong == [], f"seed {seed}"
    assert whole["leftovers"] == []
    assert deaths >= count // 2
    assert within >= count // 3
