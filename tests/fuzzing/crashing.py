"""A reader for tests of `make fuzz`: it exits its process at one number."""

from __future__ import annotations

import os
from pathlib import Path

from tests.fuzzing.fuzz import Tally

CRASHES_AT = 3


def crashing(name: str, first: int, stop: int, state: Path) -> Tally:
    """Accept everything like `worker.work`, but exit the process at one number."""
    note = state / f"{os.getpid()}.reading"
    for number in range(first, stop):
        note.write_text(f"{name}\n{number}")
        if number == CRASHES_AT:
            os._exit(11)
    note.unlink(missing_ok=True)
    return Tally(accepted=stop - first)
