"""Imports without garbage collection, in a separate process."""

from __future__ import annotations

import subprocess
import sys

import pytest

CODE = """
import gc
from stereogs.verbs.train import collector_at_rest

{before}
collections = sum(one["collections"] for one in gc.get_stats())
frozen = gc.get_freeze_count()
with collector_at_rest():
    stays = [[number] for number in range(100_000)]
    assert sum(one["collections"] for one in gc.get_stats()) == collections
    {loads}
print(gc.isenabled(), gc.get_freeze_count() - frozen > 100_000)
"""


@pytest.mark.parametrize(("before", "works"), [("", True), ("gc.disable()", False)])
@pytest.mark.parametrize(("loads", "frozen"), [("import wave", True), ("import gc", False)])
def test_the_collector_is_off_in_the_block_and_restored_afterwards(
    before: str, loads: str, *, works: bool, frozen: bool
) -> None:
    code = CODE.format(before=before, loads=loads)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == (f"{works} {frozen}\n", "")
