"""Runs: training, the run folder, its results, and scores of its views."""

from typing import TYPE_CHECKING

from core_rasterizer.first_use import names_on_first_use

if TYPE_CHECKING:
    from ..system.interrupt import stop_on_interrupt
    from ..system.lock import locked
    from ..training.checkpoint import trained_gaussians
    from .evaluation import Picture, evaluate, quick
    from .folder import METRICS, RESULTS, RunFolder
    from .opening import replay as repeat_failure
    from .options import InitialState, Plan, RunOptions
    from .results import RENDERS, read_results
    from .run import Run
    from .training_run import in_runs
else:
    __getattr__, __dir__ = names_on_first_use(__name__)

__all__ = [
    "METRICS",
    "RENDERS",
    "RESULTS",
    "InitialState",
    "Picture",
    "Plan",
    "Run",
    "RunFolder",
    "RunOptions",
    "evaluate",
    "in_runs",
    "locked",
    "quick",
    "read_results",
    "repeat_failure",
    "stop_on_interrupt",
    "trained_gaussians",
]
