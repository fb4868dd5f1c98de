"""`onnx_matching`: points of two images that show the same, by two networks in ONNX files.

See `registry.KeypointNetworks`; XFeat and LighterGlue are such networks.
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
    """The second ONNX file: it matches what `model`, the first, has found."""
    matcher_sha256: Sha256 | None = None
    """The hash that the second file must have; null takes any file."""
    value_range: ValueRange = "0..1"
    """The numbers for black and white that the first graph takes."""
    multiple: int = Field(32, ge=1)
    """Both sides of an image must be a multiple of this, where the first graph leaves them open."""
    size: tuple[int, int] | None = None
    """[width, height] given to a graph that leaves both open; null: the images' own, rounded."""
    min_score: float = Field(0.1, ge=0, le=1)
    """Matches with a lower score are left out."""
    max_epipolar_distance: float | None = Field(3.0, gt=0)
    """Between two photographs, whose cameras are known: matches farther than this from their epipolar
    line, in pixels, are left out; null keeps them."""


class OnnxMatching(MatchingPrior[OnnxMatchingSettings]):
    """Keypoints and their matches, by two graphs; images are stretched to the size of the first.

    A graph that is frozen to the other orientation is shown both images turned by a quarter.

    Raises:
        PluginError: see `OnnxModel`; or graphs of another form.
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
        """A file that finds keypoints; its `matcher` has to be said."""
        recognized = KeypointNetworks.recognizes(model)
        return [OnnxMatchingSettings.naming(model)] if recognized else []

    def fingerprint(self) -> str:
        """Both files' hashes and what runs them."""
        return self._networks.fingerprint

    def estimate(self, first: Tensor, second: Tensor) -> Matches:
        """The matches whose score suffices, in the matcher's order.

        Raises:
            PluginError: keypoints without descriptors, or matches of keypoints that there are not.
        """
        turned = self._networks.turns(first)
        here, there = (self._networks.keypoints(x, turned=turned) for x in (first, second))
        pairs, scores = self._networks.match(here, there, self.settings.min_score)
        return Matches(here.points[pairs[:, 0]], there.points[pairs[:, 1]], scores)

    def matches_between(self, first: TrainingView, second: TrainingView) -> Matches:
        """The matches of two photographs that keep to the epipolar lines of their cameras.

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
