"""`onnx_matching`: points of two images that show the same, by two networks in ONNX files.

One finds keypoints and describes them, the other matches two images' keypoints: XFeat (Potje et al.,
CVPR 2024) and LighterGlue, a small LightGlue (Lindenberger et al., ICCV 2023) that its authors trained
for it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import Field

from registry import (
    Context,
    Matches,
    MatchingPrior,
    OnnxModel,
    OnnxModelSettings,
    PluginError,
    Register,
    Sha256,
    TrainingView,
    hookimpl,
)
from registry.image_fitting import ValueRange

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from torch import Tensor

KEYPOINTS, DESCRIPTORS = "keypoints", "descriptors"
"""Outputs of the first graph: `[n, 2]` (column, row) and `[n, C]`."""
POINT_INPUTS, DESCRIPTOR_INPUTS = ("kpts0", "kpts1"), ("desc0", "desc1")
"""Inputs of the second graph, for the first and the second image: `[1, n, 2]` and `[1, n, C]`."""
MATCHES, SCORES = "matches", "scores"
"""Its outputs: `[m, 2]` numbers of keypoints, and `[m]`."""


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


@dataclass(frozen=True, eq=False)
class _Features:
    """What the first graph says of an image.

    Args:
        points: `[n, 2]` (column, row) in the image.
        given: `[1, n, 2]` the same as the matcher takes them: the longer side of what the graph was
            shown runs from -1 to 1, the shorter one in proportion, 0 in the middle.
        descriptors: `[1, n, C]`.
    """

    points: Tensor
    given: Tensor
    descriptors: Tensor


class OnnxMatching(MatchingPrior[OnnxMatchingSettings]):
    """Keypoints and their matches, by two graphs; images are stretched to the size of the first.

    A graph that is frozen to the other orientation is shown both images turned by a quarter.

    Raises:
        PluginError: see `OnnxModel`; or graphs of another form.
    """

    def __init__(self, settings: OnnxMatchingSettings, context: Context) -> None:
        super().__init__(settings, context)
        self._finder = settings.open()
        self._matcher = settings.open_another(settings.matcher, settings.matcher_sha256)
        self._image = self._finder.input()
        if len(self._image.shape) != 4 or self._image.shape[1] not in (None, 3):
            raise PluginError(
                f"the input {self._image} takes no image; expected [1, 3, H, W]",
                where=str(self._finder.path),
                fix="name the file that finds keypoints with `model`, the one that matches with `matcher`",
            )
        self._frozen = (self._image.shape[2], self._image.shape[3])
        for name in (KEYPOINTS, DESCRIPTORS):
            self._finder.output(name)
        for name in (*POINT_INPUTS, *DESCRIPTOR_INPUTS):
            self._matcher.input(name)
        for name in (MATCHES, SCORES):
            self._matcher.output(name)

    @classmethod
    def settings_for(cls, model: OnnxModel) -> Sequence[Mapping[str, Any]]:
        """A file that finds keypoints; its `matcher` has to be said."""
        answers = [spec.name for spec in model.outputs]
        found = KEYPOINTS in answers and DESCRIPTORS in answers
        return [OnnxMatchingSettings.naming(model)] if found else []

    def fingerprint(self) -> str:
        """Both files' hashes and what runs them."""
        return f"{self._finder.fingerprint} {self._matcher.fingerprint}"

    def estimate(self, first: Tensor, second: Tensor) -> Matches:
        """The matches whose score suffices, in the matcher's order.

        Raises:
            PluginError: keypoints without descriptors, or matches of keypoints that there are not.
        """
        import torch

        turned = self._turned(first)
        found = [self._features(image, turned=turned) for image in (first, second)]
        if not all(len(one.points) for one in found):
            return Matches(torch.zeros(0, 2), torch.zeros(0, 2), torch.zeros(0))
        answers = self._matcher.run(
            {
                **dict(zip(POINT_INPUTS, (one.given for one in found), strict=True)),
                **dict(zip(DESCRIPTOR_INPUTS, (one.descriptors for one in found), strict=True)),
            }
        )
        pairs, scores = answers[MATCHES].long(), answers[SCORES]
        counts = torch.tensor([len(one.points) for one in found])
        if (
            pairs.shape != (len(scores), 2)
            or scores.ndim != 1
            or bool(((pairs < 0) | (pairs >= counts)).any())
        ):
            raise PluginError(
                f"the matches {list(pairs.shape)} with scores {list(scores.shape)} are not pairs of the "
                f"{counts.tolist()} keypoints",
                where=str(self._matcher.path),
                fix="export a matcher that answers [m, 2] numbers of keypoints and [m] scores",
            )
        kept = scores >= self.settings.min_score
        here, there = pairs[kept].unbind(dim=1)
        return Matches(found[0].points[here], found[1].points[there], scores[kept])

    def matches_between(self, first: TrainingView, second: TrainingView) -> Matches:
        """The matches of two photographs that keep to the epipolar lines of their cameras.

        Raises:
            PluginError: see `MatchingPrior.matches`.
        """
        from registry import epipolar_distances

        found = super().matches_between(first, second)
        limit = self.settings.max_epipolar_distance
        if limit is None:
            return found
        kept = epipolar_distances(found, first.camera, second.camera) <= limit
        return Matches(found.first[kept], found.second[kept], found.scores[kept])

    def _turned(self, image: Tensor) -> bool:
        """Whether the graph is frozen to upright pictures and the image is not, or the reverse."""
        height, width = self._frozen
        if height is None or width is None:
            return False
        return (height - width) * (image.shape[0] - image.shape[1]) < 0

    def _features(self, image: Tensor, *, turned: bool) -> _Features:
        import torch

        from registry.image_fitting import in_range, stretched

        shown = image.rot90(dims=(0, 1)) if turned else image
        frozen = self.settings.size[::-1] if self.settings.size else self._frozen
        fit = stretched((shown.shape[0], shown.shape[1]), frozen, self.settings.multiple)
        batch = in_range(fit.apply(shown.permute(2, 0, 1)[None]), self.settings.value_range)
        answers = self._finder.run({self._image.name: batch})
        keypoints, descriptors = answers[KEYPOINTS], answers[DESCRIPTORS]
        if keypoints.ndim != 2 or descriptors.ndim != 2 or len(keypoints) != len(descriptors):
            raise PluginError(
                f"the keypoints {list(keypoints.shape)} and descriptors {list(descriptors.shape)} do not "
                "belong together, expected [n, 2] and [n, C]",
                where=str(self._finder.path),
                fix="export a graph that answers one image",
            )
        size = keypoints.new_tensor(fit.target[::-1])
        # The graph counts pixels from the middle of the first one.
        points = fit.undo_points(keypoints + 0.5)
        if turned:
            points = torch.stack([image.shape[1] - points[:, 1], points[:, 0]], dim=1)
        given = (keypoints - size / 2) / (size.max() / 2)
        return _Features(points, given[None], descriptors[None])


@hookimpl
def stereogs_register_priors(register: Register[OnnxMatching]) -> None:
    register("onnx_matching", OnnxMatching)
