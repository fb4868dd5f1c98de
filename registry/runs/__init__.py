"""Runs: training, the run folder, its results, and scores of its views."""

from typing import TYPE_CHECKING

from core_rasterizer.first_use import names_on_first_use

if TYPE_CHECKING:
    from .evaluation import evaluate, quick
    from .folder import METRICS, RESULTS, RunFolder
    from .interrupt import stop_on_interrupt
    from .lock import locked
    from .options import Fit, InitialState, RunOptions
    from .progress import ShownBar
    from .replay import replay as repeat_failure
    from .results import RENDERS
    from .results_file import read_results
    from .run import Picture, Run
    from .run_table import ABSENT
    from .training_run import in_runs
else:
    __getattr__, __dir__ = names_on_first_use(__name__)

__all__ = [
    "ABSENT",
    "METRICS",
    "RENDERS",
    "RESULTS",
    "Fit",
    "InitialState",
    "Picture",
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
]
