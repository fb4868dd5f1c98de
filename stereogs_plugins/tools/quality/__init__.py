"""Choice of a pipeline and its length from the scene and the time available."""

from __future__ import annotations

import logging
import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from registry.runs import Fit


def within(seconds: float) -> Fit:
    """For `train(..., fit=within(20))`: as many iterations as fit into the seconds, from now to the end.

    Iterations are measured on the scene and this machine; schedules scale with their number, which never
    exceeds that of the pipeline. `run.pipeline` holds the number: trained again, it gives the same bits.

    Args:
        seconds: wall-clock seconds, > 0, scores and files included.
    """
    from .fitting import Budget, fit_length

    budget, log = Budget(seconds, time.monotonic()), logging.getLogger("stereogs.quality")
    return lambda initial: fit_length(initial, budget, log.info)
