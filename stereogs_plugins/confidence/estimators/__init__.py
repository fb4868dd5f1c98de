"""Estimators of confidence: `fisher`, `support`, `coverage` and their combination `calibrated`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field

from registry import PluginError, Register, Settings, hookimpl
from registry.confidence import Confidence, ConfidenceEstimator, Trained

if TYPE_CHECKING:
    from .fisher import FisherConfidence


class Calibrated(ConfidenceEstimator[Settings]):
    """Probability of an error of at most 0.1, from kinds, coverage, photographs and training errors."""

    def estimate(self, trained: Trained) -> Confidence:
        """Render the training views once, and differentiate them."""
        from .calibrated import CalibratedConfidence

        return CalibratedConfidence(trained)


class CoverageSettings(Settings):
    angle: Annotated[float, Field(gt=0, le=180)] = 30.0
    """Angle between the rays of two cameras, in degrees, at which one tells little about the other's image:
    a camera counts by exp(-angle / this)."""


class Coverage(ConfidenceEstimator[CoverageSettings]):
    """How many training cameras see each pixel's surface, unoccluded, and from how near an angle."""

    def estimate(self, trained: Trained) -> Confidence:
        """Render the depth of the training views."""
        from .coverage import CoverageConfidence

        return CoverageConfidence(trained, self.settings.angle)


class FisherSettings(Settings):
    prior: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 1e-6
    """Information before any photograph, for each parameter (lambda in the paper). Colours in [0, 1] count
    with a variance of 1."""
    probes: Annotated[int, Field(ge=1)] = 2
    """Backward passes for each view; the information's relative error is about sqrt(2 / probes)."""


class Fisher(ConfidenceEstimator[FisherSettings]):
    """Diagonal Fisher information of the Gaussians' parameters from the training views."""

    def estimate(self, trained: Trained) -> FisherConfidence:
        """Make one pass over the training views."""
        from .fisher import FisherConfidence

        settings = self.settings
        return FisherConfidence(trained, settings.prior, settings.probes, self.generator)


class Support(ConfidenceEstimator[Settings]):
    """Share of each pixel's light from points that several photographs confirmed."""

    def estimate(self, trained: Trained) -> Confidence:
        """Read the kinds of the Gaussians.

        Raises:
            PluginError: the initializer does not mark confirmed points.
        """
        from .support import CONFIRMED, SupportConfidence

        if CONFIRMED not in trained.kinds:
            raise PluginError(
                "the initializer of this run does not mark confirmed points",
                fix="use the estimator `coverage` or `fisher`, or train with `consistency_dense`",
            )
        return SupportConfidence(trained)


@hookimpl
def stereogs_register_confidence_estimators(register: Register[ConfidenceEstimator[Any]]) -> None:
    register("calibrated", Calibrated)
    register("coverage", Coverage)
    register("fisher", Fisher)
    register("support", Support)
