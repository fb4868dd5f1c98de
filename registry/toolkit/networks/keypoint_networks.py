"""Keypoints and their matches by two networks in ONNX files.

One finds keypoints and describes them, the other matches two images' keypoints: XFeat (Potje et al.,
CVPR 2024) and LighterGlue, a small LightGlue (Lindenberger et al., ICCV 2023) that its authors trained
for it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ...errors import PluginError
from .image_fitting import ValueRange, in_range, stretched

if TYPE_CHECKING:
    from torch import Tensor

    from .onnx_model import OnnxModel

KEYPOINTS, DESCRIPTORS = "keypoints", "descriptors"
"""Outputs of the first graph: `[n, 2]` (column, row) and `[n, C]`."""
POINT_INPUTS, DESCRIPTOR_INPUTS = ("kpts0", "kpts1"), ("desc0", "desc1")
"""Inputs of the second graph, for the first and the second image: `[1, n, 2]` and `[1, n, C]`."""
MATCHES, SCORES = "matches", "scores"
"""Its outputs: `[m, 2]` numbers of keypoints, and `[m]`."""


@dataclass(frozen=True, eq=False)
class Keypoints:
    """What the first graph says of an image.

    Args:
        points: `[n, 2]` (column, row) in the image, pixels.
        given: `[1, n, 2]` the same as the matcher takes them: the longer side of what the graph was
            shown runs from -1 to 1, the shorter one in proportion, 0 in the middle.
        descriptors: `[1, n, C]`.
    """

    points: Tensor
    given: Tensor
    descriptors: Tensor


class KeypointNetworks:
    """The two graphs; images are stretched to the size of the first.

    Args:
        finder: answers `KEYPOINTS` and `DESCRIPTORS` of one image `[1, 3, H, W]`.
        matcher: answers `MATCHES` and `SCORES` of two images' keypoints.
        value_range: the numbers for black and white that the finder takes.
        multiple: both sides of an image must be a multiple of this, where the finder leaves them open.
        size: (width, height) given to a finder that leaves both open; None: the images' own, rounded.

    Raises:
        PluginError: graphs of another form.
    """

    def __init__(
        self,
        finder: OnnxModel,
        matcher: OnnxModel,
        *,
        value_range: ValueRange = "0..1",
        multiple: int = 32,
        size: tuple[int, int] | None = None,
    ) -> None:
        self._finder, self._matcher = finder, matcher
        self._value_range, self._multiple = value_range, multiple
        self._image = finder.input()
        if len(self._image.shape) != 4 or self._image.shape[1] not in (None, 3):
            raise PluginError(
                f"the input {self._image} takes no image; expected [1, 3, H, W]",
                where=str(finder.path),
                fix="name the file that finds keypoints with `model`, the one that matches with `matcher`",
            )
        for name in (KEYPOINTS, DESCRIPTORS):
            finder.output(name)
        for name in (*POINT_INPUTS, *DESCRIPTOR_INPUTS):
            matcher.input(name)
        for name in (MATCHES, SCORES):
            matcher.output(name)
        self._frozen = (self._image.shape[2], self._image.shape[3])
        self._target = size[::-1] if size else self._frozen

    @staticmethod
    def recognizes(model: OnnxModel) -> bool:
        """Whether a model has the outputs of one that finds keypoints."""
        return {KEYPOINTS, DESCRIPTORS} <= {spec.name for spec in model.outputs}

    @property
    def fingerprint(self) -> str:
        """Both files' hashes and what runs them."""
        return f"{self._finder.fingerprint} {self._matcher.fingerprint}"

    def turns(self, image: Tensor) -> bool:
        """Whether the finder is frozen to upright pictures and the image `[H, W, 3]` lies, or the reverse."""
        height, width = self._frozen
        if height is None or width is None:
            return False
        return (height - width) * (image.shape[0] - image.shape[1]) < 0

    def keypoints(self, image: Tensor, *, turned: bool) -> Keypoints:
        """The keypoints of an image `[H, W, 3]` float32 in [0, 1].

        Args:
            turned: show it turned by a quarter; of two images that are matched, both or none.

        Raises:
            PluginError: keypoints without descriptors.
        """
        import torch

        shown = image.rot90(dims=(0, 1)) if turned else image
        fit = stretched((shown.shape[0], shown.shape[1]), self._target, self._multiple)
        batch = in_range(fit.apply(shown.permute(2, 0, 1)[None]), self._value_range)
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
        return Keypoints(points, given[None], descriptors[None])

    def match(self, first: Keypoints, second: Keypoints, min_score: float) -> tuple[Tensor, Tensor]:
        """Which keypoints show the same: pairs of numbers `[m, 2]` int64, and scores `[m]` in [0, 1].

        Args:
            min_score: matches with a lower score are left out.

        Raises:
            PluginError: matches of keypoints that there are not.
        """
        import torch

        counts = torch.tensor([len(first.points), len(second.points)])
        if not counts.all():
            return torch.zeros(0, 2, dtype=torch.int64), torch.zeros(0)
        found = (first, second)
        answers = self._matcher.run(
            {
                **dict(zip(POINT_INPUTS, (one.given for one in found), strict=True)),
                **dict(zip(DESCRIPTOR_INPUTS, (one.descriptors for one in found), strict=True)),
            }
        )
        pairs, scores = answers[MATCHES].long(), answers[SCORES]
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
        kept = scores >= min_score
        return pairs[kept], scores[kept]
