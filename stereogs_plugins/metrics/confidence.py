"""`psnr_seen`, `psnr_unseen`, `seen`, `psnr_predicted` and `view_angle`: scores by confidence and by angle.

Methods differ most in parts that no photograph shows. These scores compare the other parts separately.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any
from weakref import WeakKeyDictionary

from pydantic import Field

from registry import Register, Scene, Settings, Unavailable, View, ViewMetric, hookimpl
from registry.toolkit.images import decibels

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Rendering
    from registry.confidence import Confidence, Trained

_DURING_TRAINING = Unavailable("confidence is estimated after training only")


class ConfidenceSettings(Settings):
    estimator: str = "calibrated"
    """Name of the confidence estimator; `stereogs plugins` lists them."""
    threshold: Annotated[float, Field(ge=0, le=1)] = 0.5
    """Confidence from which a pixel counts as seen."""


class _Maps:
    """Confidence of one training, each view's map estimated once for all metrics."""

    def __init__(self, confidence: Confidence) -> None:
        self._confidence = confidence
        self._maps: dict[str, Tensor] = {}

    def of(self, view: View) -> Tensor:
        if view.name not in self._maps:
            self._maps[view.name] = self._confidence.of(view.camera)
        return self._maps[view.name]


_MAPS: WeakKeyDictionary[Trained, dict[str, _Maps]] = WeakKeyDictionary()


class _OfConfidence(ViewMetric[ConfidenceSettings]):
    takes_long = True
    equal_images_are_best = False
    unit = "dB"
    _trained: Trained | None = None

    def begin_scoring(self, trained: Trained) -> None:
        self._trained = trained

    def confidence(self, view: View) -> Tensor | None:
        """Return `[H, W]`, or None during training."""
        if self._trained is None:
            return None
        name, known = self.settings.estimator, _MAPS.setdefault(self._trained, {})
        if name not in known:
            known[name] = _Maps(self._trained.confidence(name))
        return known[name].of(view)


class PSNRSeen(_OfConfidence):
    """PSNR over the pixels of a test view whose confidence reaches the threshold."""

    wanted = True

    def measure_view(self, rendering: Rendering, view: View, scene: Scene) -> float | Unavailable:
        """Return decibels, at most 100; not available for a view without such pixels."""
        confidence = self.confidence(view)
        if confidence is None:
            return _DURING_TRAINING
        chosen = (confidence >= self.settings.threshold) == self.wanted
        if view.mask is not None:
            chosen &= view.mask
        if not chosen.any():
            return Unavailable(f"a view has no {'seen' if self.wanted else 'unseen'} pixels")
        return decibels((rendering.rgb - view.image).square()[chosen].mean())


class PSNRUnseen(PSNRSeen):
    """PSNR over the other pixels of a test view, which the photographs do not determine."""

    wanted = False


class Seen(_OfConfidence):
    """Share of a test view's pixels, 0 to 1, whose confidence reaches the threshold."""

    unit = ""

    def measure_view(self, rendering: Rendering, view: View, scene: Scene) -> float | Unavailable:
        """Return the share, inside the view's mask."""
        confidence = self.confidence(view)
        if confidence is None:
            return _DURING_TRAINING
        seen = confidence >= self.settings.threshold
        return float((seen if view.mask is None else seen[view.mask]).double().mean())


class PSNRPredicted(_OfConfidence):
    """PSNR of a test view that the confidence predicts, without its photograph."""

    def measure_view(self, rendering: Rendering, view: View, scene: Scene) -> float | Unavailable:
        """Return decibels."""
        from registry.toolkit.images import predicted_psnr

        confidence = self.confidence(view)
        if confidence is None:
            return _DURING_TRAINING
        return predicted_psnr(confidence if view.mask is None else confidence[view.mask])


class ViewAngle(ViewMetric[Settings]):
    """Angle to the nearest training camera in degrees, seen from the middle of the view."""

    higher_is_better = False
    equal_images_are_best = False
    takes_long = True
    unit = "degrees"

    def measure_view(self, rendering: Rendering, view: View, scene: Scene) -> float:
        """Return the angle; it needs no render."""
        from registry.toolkit.views import subject_of, view_angles

        points = None if scene.points is None else scene.points.positions
        subject = subject_of(view.camera, scene.bounds, points)
        return view_angles(view.camera, [other.camera for other in scene.train], subject).nearest


@hookimpl
def stereogs_register_metrics(register: Register[ViewMetric[Any]]) -> None:
    register("psnr_seen", PSNRSeen)
    register("psnr_unseen", PSNRUnseen)
    register("seen", Seen)
    register("psnr_predicted", PSNRPredicted)
    register("view_angle", ViewAngle)
