"""`onnx_matching`: matches between two images by two networks in ONNX files.

See `registry.KeypointNetworks`, for example XFeat and LighterGlue.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import Field

from registry import Context, Register, TrainingView, hookimpl
from registry.priors import Matches, MatchingPrior
from registry.toolkit.networks import KeypointNetworks, OnnxModel, OnnxModelSettings, Sha256
from registry.toolkit.networks.image_fitting import ValueRange

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from torch import Tensor


class OnnxMatchingSettings(OnnxModelSettings):
    matcher: Path
    """Path of the second ONNX file, which matches the keypoints of the first (`model`)."""
    matcher_sha256: Sha256 | None = None
    """Required hash of the second file; null accepts any file."""
    value_range: ValueRange = "0..1"
    """Range of the first graph's pixel values, from black to white."""
    multiple: int = Field(32, ge=1)
    """Both sides of an image are resized to a multiple of this, if the first graph's size is dynamic."""
    size: tuple[int, int] | None = None
    """[width, height] of the input of a graph with dynamic size; null: the image's own, rounded."""
    min_score: float = Field(0.1, ge=0, le=1)
    """Drop matches with a lower score."""
    max_epipolar_distance: float | None = Field(3.0, gt=0)
    """Between photographs with known cameras, drop matches farther than this from their epipolar line, in
    pixels; null keeps them."""


class OnnxMatching(MatchingPrior[OnnxMatchingSettings]):
    """Keypoints and their matches by two graphs; images are stretched to the size of the first.

    Both images are rotated by 90 degrees for a graph whose fixed size has the other orientation.

    Raises:
        PluginError: see `OnnxModel`; or the graphs have another form.
    """

    def __init__(self, settings: OnnxMatchingSettings, context: Context) -> None:
        super().__init__(settings, context)
        self._networks = KeypointNetworks(
            settings.open(),
            settings.open_another(settings.matcher, settings.matcher_sha256),
            value_range=settings.value_range,
            multiple=settings.multiple,
            size=settings.size,
        )

    @classmethod
    def settings_for(cls, model: OnnxModel) -> Sequence[Mapping[str, Any]]:
        """Settings for a file that finds keypoints; `matcher` must be added."""
        recognized = KeypointNetworks.recognizes(model)
        return [OnnxMatchingSettings.naming(model)] if recognized else []

    def fingerprint(self) -> str:
        """Hashes of both files, and their execution provider."""
        return self._networks.fingerprint

    def estimate(self, first: Tensor, second: Tensor) -> Matches:
        """Matches with at least `min_score`, in the matcher's order.

        Raises:
            PluginError: keypoints without descriptors, or matches of keypoints that do not exist.
        """
        turned = self._networks.turns(first)
        here, there = (self._networks.keypoints(x, turned=turned) for x in (first, second))
        pairs, scores = self._networks.match(here, there, self.settings.min_score)
        return Matches(here.points[pairs[:, 0]], there.points[pairs[:, 1]], scores)

    def matches_between(self, first: TrainingView, second: TrainingView) -> Matches:
        """Matches of two photographs that are close to the epipolar lines of their cameras.

        Raises:
            PluginError: see `MatchingPrior.matches`.
        """
        from registry.toolkit.views import epipolar_distances

        found = super().matches_between(first, second)
        limit = self.settings.max_epipolar_distance
        if limit is None:
            return found
        kept = epipolar_distances(found, first.camera, second.camera) <= limit
        return Matches(found.first[kept], found.second[kept], found.scores[kept])


@hookimpl
def stereogs_register_priors(register: Register[OnnxMatching]) -> None:
    register("onnx_matching", OnnxMatching)
