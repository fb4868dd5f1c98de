"""Damage files at random; readers must return valid data or raise an explained error."""

from __future__ import annotations

import random
import time
import traceback
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from unittest import mock

from tests.fuzzing.damage import damage
from tests.fuzzing.guard import Forbidden, watched
from tests.fuzzing.target import Target
from tests.host import peak_memory_mb

SLOWEST = 10.0
"""CPU seconds that reading a tiny file may take; `tests/fuzzing/worker.py` ends readers that only wait."""
MEMORY_TIMES = 10
MEMORY_PLUS = 64 * 1024 * 1024
"""Memory that a reader may use: this multiple of the file's size, plus this many bytes."""


@dataclass
class Tally:
    """Results for some inputs.

    Args:
        failures: Violations by number.
    """

    accepted: int = 0
    refused: int = 0
    failures: dict[int, str] = field(default_factory=dict)


def fuzz(
    target: Target, numbers: Iterable[int], starts: Callable[[int], object] = lambda number: None
) -> Tally:
    """Read a damaged version of a target's files for each number.

    Args:
        starts: Called with each number before its file is read.
    """
    target.read()  # the undamaged file is accepted; this also imports all modules that reading needs
    tally = Tally()
    # Starting more threads takes longer than reading such a small file.
    with mock.patch("registry.toolkit.progress.parallel.usable_cores", return_value=1):
        for number in numbers:
            starts(number)
            _try(target, number, tally)
    return tally


def _try(target: Target, number: int, tally: Tally) -> None:
    randomness = random.Random(f"{target.name} {number}")
    file = randomness.choice(target.files)
    content = damage(target.whole(file), file, randomness)
    before, start = _peak_bytes(), time.process_time()
    try:
        with watched(target.folder.parent):
            accepted = target.accepts(file, content)
        _check_cost(time.process_time() - start, _peak_bytes() - before, len(content))
    except KeyboardInterrupt:
        raise
    except (Exception, Forbidden, SystemExit):
        tally.failures[number] = f"{file}: {traceback.format_exc()}"
    else:
        tally.accepted += accepted
        tally.refused += not accepted


def _peak_bytes() -> float:
    """Return the peak memory of this process; 0 if the system does not report it."""
    return (peak_memory_mb() or 0.0) * 1e6


def _check_cost(seconds: float, grown: float, size: int) -> None:
    assert grown <= MEMORY_TIMES * size + MEMORY_PLUS, f"memory grew by {grown / 1e6:.0f} MB"
    assert seconds < SLOWEST, f"it took {seconds:.1f} s of a core"


def folder_for(name: str, root: Path) -> Path:
    """Create a folder for a target, so that writes outside it can be detected."""
    folder = root / name.replace(" ", "-") / "files"
    folder.mkdir(parents=True)
    return folder
