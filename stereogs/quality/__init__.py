"""Choose a pipeline and its length from the scene and the available time."""

from __future__ import annotations

import logging
import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .fitting import Fit


def within(seconds: float) -> Fit:
    """Return the argument `fit` of `train` for a run that takes `seconds` in total, from now on.

    Iterations are timed on the scene and this machine; schedules scale with their number, which never
    exceeds that of the pipeline. It is at least 30, even if the run then takes longer. `run.pipeline`
    stores the number: training it again gives the same bits.

    Args:
        seconds: wall-clock seconds, > 0, including scores and files.
    """
    from .within_seconds import Budget, WithinSeconds

    log = logging.getLogger("stereogs.quality").info
    return WithinSeconds(log, budget=Budget(seconds, time.monotonic()))
