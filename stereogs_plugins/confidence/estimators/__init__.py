"""Estimators of confidence: `fisher`, `support`, `coverage` and their combination `calibrated`."""

from __future__ import annotations

from typing import Any

from registry import Register, hookimpl
from registry.confidence import ConfidenceEstimator

from .calibrated import Calibrated
from .coverage import Coverage
from .fisher import Fisher
from .support import Support


@hookimpl
def stereogs_register_confidence_estimators(register: Register[ConfidenceEstimator[Any]]) -> None:
    register("calibrated", Calibrated)
    register("coverage", Coverage)
    register("fisher", Fisher)
    register("support", Support)
