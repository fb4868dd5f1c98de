"""Runs: training, the run folder, its results, and scores of its views."""

from typing import TYPE_CHECKING

from core_rasterizer.first_use import names_on_first_use

if TYPE_CHECKING:
    from ..calls.copies import copied
    from ..system.interrupt import stop_on_interrupt
    from ..system.lock import locked
    from ..training.checkpoint import trained_gaussians
    from .evaluation import Picture, evaluate, quick
    from .folder import METRICS, RESULTS, RunFolder
    from .opening import FAILURES
    from .options import InitialState, Plan, RunOptions
    from .origin import compare_inputs
    from .results import EXPORTS, RENDERS, existing_files, read_results, score_of
    from .run import Run
    from .training_run import in_runs
else:
    __getattr__, __dir__ = names_on_first_use(__name__)

__all__ = [
    "EXPORTS",
    "FAILURES",
    "METRICS",
    "RENDERS",
    "RESULTS",
    "InitialState",
    "Picture",
    "Plan",
    "Run",
    "RunFolder",
    "RunOptions",
    "compare_inputs",
    "copied",
    "evaluate",
    "existing_files",
    "in_runs",
    "locked",
    "quick",
    "read_results",
    "score_of",
    "stop_on_interrupt",
    "trained_gaussians",
]
