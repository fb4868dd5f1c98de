"""Runs: training, the run folder, its results, and scores of its views."""

from typing import TYPE_CHECKING

from core_rasterizer.first_use import names_on_first_use

if TYPE_CHECKING:
    from ..training.checkpoint import trained_gaussians
    from .beginning import Beginning, Fit
    from .evaluation import evaluate, quick
    from .folder import METRICS, RESULTS, RunFolder
    from .guarding.interrupt import stop_on_interrupt
    from .guarding.lock import locked
    from .observing.progress import ShownBar
    from .options import RunOptions
    from .replay import replay as repeat_failure
    from .results import RENDERS
    from .results import report as write_reports
    from .results_file import read_results
    from .run import Run
    from .training_run import in_runs
else:
    __getattr__, __dir__ = names_on_first_use(__name__)

__all__ = [
    "METRICS",
    "RENDERS",
    "RESULTS",
    "Beginning",
    "Fit",
    "Run",
    "RunFolder",
    "RunOptions",
    "ShownBar",
    "evaluate",
    "in_runs",
    "locked",
    "quick",
    "read_results",
    "repeat_failure",
    "stop_on_interrupt",
    "trained_gaussians",
    "write_reports",
]
