"""Find and match keypoints with two networks in ONNX files.

The finder returns keypoints and descriptors of an image, the matcher pairs the keypoints of two images, as
XFeat (Potje et al., CVPR 2024) with LighterGlue (after Lindenberger et al., ICCV 2023). Tensors by name:

    finder    input [1, 3, H, W]; outputs keypoints [n, 2] (column, row), descriptors [n, C]
    matcher   inputs kpts0, kpts1 [1, n, 2], desc0, desc1 [1, n, C]; outputs matches [m, 2], scores [m]
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
POINT_INPUTS, DESCRIPTOR_INPUTS = ("kpts0", "kpts1"), ("desc0", "desc1")
MATCHES, SCORES = "matches", "scores"


@dataclass(frozen=True, eq=False)
class Keypoints:
    """Keypoints of an image.

    Args:
        points: `[n, 2]` (column, row) in the image, pixels.
        normalized: `[1, n, 2]` coordinates for the matcher: the longer side of the finder's input runs from
            -1 to 1, the shorter side in proportion, with 0 at the center.
        descriptors: `[1, n, C]`.
    """

    points: Tensor
    normalized: Tensor
    descriptors: Tensor


class KeypointNetworks:
    """A finder and a matcher; images are stretched to the size of the finder's input.

    Args:
        finder: Network that returns `KEYPOINTS` and `DESCRIPTORS`.
        matcher: Network that returns `MATCHES` and `SCORES`.
        value_range: Range of the colors in the finder's input.
        multiple: Divisor of both sides of the finder's input, if it has a dynamic size.
        size: (width, height) of the finder's input, if it has a dynamic size; None keeps the image's
            size, rounded to `multiple`.

    Raises:
        PluginError: A graph has other inputs or outputs.
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
                f"the input {self._image} is not an image; expected [1, 3, H, W]",
                where=str(finder.path),
                fix="set `model` to the file that finds keypoints, `matcher` to the one that matches them",
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
        """Return whether a model has the outputs of a finder."""
        return {KEYPOINTS, DESCRIPTORS} <= {spec.name for spec in model.outputs}

    @property
    def fingerprint(self) -> str:
        """Fingerprints of both models, see `OnnxModel.fingerprint`."""
        return f"{self._finder.fingerprint} {self._matcher.fingerprint}"

    def turns(self, image: Tensor) -> bool:
        """Return whether an image `[H, W, 3]` and the finder's fixed size differ in orientation."""
        height, width = self._frozen
        if height is None or width is None:
            return False
        return (height - width) * (image.shape[0] - image.shape[1]) < 0

    def keypoints(self, image: Tensor, *, turned: bool) -> Keypoints:
        """Return the keypoints of an image `[H, W, 3]` float32 in [0, 1].

        Args:
            turned: If True, the finder sees the image rotated by 90 degrees. Use the same value for both
                images of a pair.

        Raises:
            PluginError: The numbers of keypoints and descriptors differ.
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
                fix="export a graph that processes one image",
            )
        size = keypoints.new_tensor(fit.target[::-1])
        # In the graph, the center of the first pixel is (0, 0).
        points = fit.undo_points(keypoints + 0.5)
        if turned:
            points = torch.stack([image.shape[1] - points[:, 1], points[:, 0]], dim=1)
        normalized = (keypoints - size / 2) / (size.max() / 2)
        return Keypoints(points, normalized[None], descriptors[None])

    def match(self, first: Keypoints, second: Keypoints, min_score: float) -> tuple[Tensor, Tensor]:
        """Return pairs of keypoint indices `[m, 2]` int64, and their scores `[m]` in [0, 1].

        Args:
            min_score: Lowest score to keep.

        Raises:
            PluginError: The matcher returns other shapes or indices out of range.
        """
        import torch

        counts = torch.tensor([len(first.points), len(second.points)])
        if not counts.all():
            return torch.zeros(0, 2, dtype=torch.int64), torch.zeros(0)
        inputs = dict(zip(POINT_INPUTS, (first.normalized, second.normalized), strict=True))
        inputs |= zip(DESCRIPTOR_INPUTS, (first.descriptors, second.descriptors), strict=True)
        answers = self._matcher.run(inputs)
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
                fix="export a matcher that returns indices [m, 2] of keypoints and scores [m]",
            )
        kept = scores >= min_score
        return pairs[kept], scores[kept]
