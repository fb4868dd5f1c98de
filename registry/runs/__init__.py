"""Runs: training, the run folder, its results, and scores of its views."""

from typing import TYPE_CHECKING

from core_rasterizer.first_use import names_on_first_use

if TYPE_CHECKING:
    from ..training.checkpoint import trained_gaussians
    from .results import read_results, score_of
else:
    __getattr__, __dir__ = names_on_first_use(__name__)

__all__ = ["read_results", "score_of", "trained_gaussians"]
