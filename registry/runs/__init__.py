"""Runs: training, the run folder, its results, and scores of its views."""

from typing import TYPE_CHECKING

from core_rasterizer.first_use import names_on_first_use

if TYPE_CHECKING:
    from ..training.checkpoint import trained_gaussians as trained_gaussians
    from .results import read_results as read_results, score_of as score_of
else:
    __all__, __dir__, __getattr__ = names_on_first_use(__name__)
