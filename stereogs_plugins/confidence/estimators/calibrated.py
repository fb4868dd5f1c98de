"""`calibrated`: one number from all evidence, fitted to the errors on training views that were left out."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import torch
from torch.nn.functional import avg_pool2d, pad

from registry.confidence import Confidence, Trained
from registry.toolkit.images import MAX_CORRECT_ERROR

from .coverage import CoverageConfidence
from .residuals import Residuals
from .support import SupportConfidence

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Camera
    from registry import TrainingScene

_ANGLE = 30.0
"""Of coverage, in degrees, when the weights were fitted."""
_TEXTURE = 7
"""Side in pixels of the window in which the render's contrast is measured."""
_SAME_COLOR = 0.02
"""Largest difference, mean of the channels, of a pixel that shows the background."""
_UNKNOWN_TEXTURE, _UNKNOWN_RESIDUAL, _UNKNOWN_DIFFERENCE = 0.005, 0.003, 0.01
"""Least values, before logarithms."""


class Evidence(NamedTuple):
    """Numbers of each pixel from which its error is predicted, or their weights.

    Args:
        one: 1.
        confirmed, filled: shares of the pixel's light by kind.
        first: weight of the training camera that sees the surface best (`coverage`).
        least_difference: logarithm of the difference between the render and the photograph with the most
            similar colour there, occluded or not.
        residual: logarithm of the Gaussians' error on the training photographs.
        texture: logarithm of the render's contrast.
        hole: share of the background, unless the photographs show a background of this colour.
        angle: logarithm of 1 + degrees to the nearest ray of a training camera, occluded or not: error grows
            with this angle ("Mind the Gap", arXiv 2607.01556).
    """

    one: Tensor | float
    confirmed: Tensor | float
    filled: Tensor | float
    first: Tensor | float
    least_difference: Tensor | float
    residual: Tensor | float
    texture: Tensor | float
    hole: Tensor | float
    angle: Tensor | float


WEIGHTS = Evidence(-0.357, -0.36, 0.178, -0.319, 0.239, 0.365, 0.098, 2.055, 0.167)
"""Fitted as `python -m benchmarks.confidence --fit` does, to other random pixels of the same views:
training views that were left out, no test views."""


class CalibratedConfidence(Confidence):
    """Predicted error of each pixel, and the probability that it is small.

    Args:
        trained: Gaussians, training views, kinds.
    """

    def __init__(self, trained: Trained) -> None:
        self._coverage = CoverageConfidence(trained, _ANGLE)
        self._support, self._residuals = SupportConfidence(trained), Residuals(trained)
        self._holes = max(0.0, 1 - 2 * _plain_share(trained.scene))

    def evidence(self, camera: Camera) -> Evidence:
        """Return the evidence for each pixel of a camera, `[H, W]` each."""
        rendering, views = self._coverage.seen_by(camera)
        weights = torch.stack([self._coverage.weight(view) for view in views])
        angles = torch.stack([view.angle for view in views])
        differences = [(view.color - rendering.rgb).abs().mean(dim=2) for view in views]
        least = torch.stack(differences).amin(dim=0)
        shares = self._support.shares(camera)
        residual = self._residuals.render(camera).clamp(min=_UNKNOWN_RESIDUAL)
        return Evidence(
            one=torch.ones_like(rendering.alpha),
            confirmed=shares[..., 0],
            filled=shares[..., 1],
            first=weights.amax(dim=0),
            least_difference=least.clamp(min=_UNKNOWN_DIFFERENCE).log(),
            residual=residual.log(),
            texture=_contrast(rendering.rgb.mean(dim=2)).clamp(min=_UNKNOWN_TEXTURE).log(),
            hole=self._holes * (1 - rendering.alpha),
            angle=angles.amin(dim=0).log1p(),
        )

    def error(self, camera: Camera) -> Tensor:
        """Return `[H, W]`: the predicted mean difference of a pixel's channels from a photograph."""
        terms = zip(WEIGHTS, self.evidence(camera), strict=True)
        logarithm = torch.stack([torch.as_tensor(w * value) for w, value in terms]).sum(dim=0)
        return logarithm.clamp(-8, 0).exp()

    def of(self, camera: Camera) -> Tensor:
        """Return the probability that each pixel's error is at most `RIGHT`."""
        return probability_of(self.error(camera))


def probability_of(error: Tensor) -> Tensor:
    """Return the probability of an error of at most `RIGHT`, for errors with an exponential distribution.

    On left-out views the share of right pixels agrees with it within 0.05 up to a mean of 0.3.
    """
    return 1 - torch.exp(-MAX_CORRECT_ERROR / error)


def _plain_share(scene: TrainingScene) -> float:
    """Return the share of the photographs' pixels that have the colour of the scene's background."""
    background = torch.tensor(scene.background)
    shares = [
        ((view.image - background).abs().mean(dim=2) < _SAME_COLOR).float().mean()
        for view in scene.train
    ]
    return float(torch.stack(shares).mean())


def _contrast(image: Tensor) -> Tensor:
    """Return the standard deviation `[H, W]` of an image in a window around each pixel."""

    def blurred(values: Tensor) -> Tensor:
        edge = _TEXTURE // 2
        padded = pad(values[None, None], (edge,) * 4, mode="replicate")
        return avg_pool2d(padded, _TEXTURE, 1)[0, 0]

    return (blurred(image**2) - blurred(image) ** 2).clamp(min=0).sqrt()
