"""Features of images from networks in ONNX files: one per pixel, or keypoints with their matches.

`LearnedFeatures` has the interface of the MC-CNN "fast" architecture (Zbontar and LeCun, "Stereo Matching
by Training a Convolutional Neural Network to Compare Image Patches", JMLR 2016): the input is a
standardized grey image; the similarity of two pixels is the dot product of their unit feature vectors.

`KeypointNetworks` runs two networks: the finder returns keypoints and descriptors of an image, the matcher
pairs the keypoints of two images, as XFeat (Potje et al., CVPR 2024) with LighterGlue (after Lindenberger
et al., ICCV 2023). Tensors by name:

    finder    input [1, 3, H, W]; outputs keypoints [n, 2] (column, row), descriptors [n, C]
    matcher   inputs kpts0, kpts1 [1, n, 2], desc0, desc1 [1, n, C]; outputs matches [m, 2], scores [m]
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from registry.toolkit.images import grey

from ...errors import PluginError
from .image_fitting import ValueRange, in_range, stretched
from .onnx_model import OnnxModel

if TYPE_CHECKING:
    from pathlib import Path

    from torch import Tensor

    from .onnx_session import OnnxProvider

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
        multiple, size: Divisor of both sides and (width, height) of the finder's input, if it has a
            dynamic size; None keeps the image's size, rounded to `multiple`.

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
            turned: Rotate the image by 90 degrees for the finder; use one value for both images of a pair.

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
        """Return pairs of keypoint indices `[m, 2]` int64, and their scores `[m]` in [min_score, 1].

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
        paired = pairs.shape == (len(scores), 2) and scores.ndim == 1
        if not paired or bool(((pairs < 0) | (pairs >= counts)).any()):
            raise PluginError(
                f"the matches {list(pairs.shape)} with scores {list(scores.shape)} are not pairs of the "
                f"{counts.tolist()} keypoints",
                where=str(self._matcher.path),
                fix="export a matcher that returns indices [m, 2] of keypoints and scores [m]",
            )
        kept = scores >= min_score
        return pairs[kept], scores[kept]


class LearnedFeatures:
    """A function that returns a unit feature vector for each pixel of an image.

    Args:
        path: Path of an ONNX model with one input `[N, 1, H, W]` of dynamic size, a standardized grey
            image, and one output `[N, C, H, W]`.
        sha256, provider: See `OnnxModel`.

    Raises:
        PluginError: See `OnnxModel`; also if the graph has several inputs or outputs.
    """

    def __init__(
        self, path: str | Path, sha256: str | None = None, provider: OnnxProvider | None = None
    ) -> None:
        self._model = OnnxModel(path, sha256, provider)
        self._input, self._output = self._model.input().name, self._model.output().name

    @staticmethod
    def recognizes(model: OnnxModel) -> bool:
        """Return whether the shapes of a model's input and output match this class."""
        if len(model.inputs) != 1 or len(model.outputs) != 1:
            return False
        image, features = model.inputs[0].shape, model.outputs[0].shape
        return len(image) == len(features) == 4 and image[1] == 1 and features[1] != 1

    @property
    def fingerprint(self) -> str:
        """See `OnnxModel.fingerprint`."""
        return self._model.fingerprint

    def __call__(self, image: Tensor) -> Tensor:
        """Return features `[C, H, W]` of an image `[H, W, 3]` in [0, 1], with norm 1 or 0 over C; float32.

        Raises:
            PluginError: The model returns another size or non-finite values.
        """
        import torch
        from torch.nn.functional import normalize

        network_input = standardized_grey(image)
        features = self._model.run({self._input: network_input[None, None]})[self._output]
        height, width = network_input.shape
        if features.ndim != 4 or features.shape[0] != 1 or features.shape[2:] != (height, width):
            raise PluginError(
                f"the features have the shape {list(features.shape)}, "
                f"expected [1, C, {height}, {width}]",
                where=str(self._model.path),
                fix="use a model that returns one vector for each pixel",
            )
        if not torch.isfinite(features).all():
            raise PluginError("a feature is not finite", where=str(self._model.path))
        return normalize(features[0], dim=0)


def standardized_grey(image: Tensor) -> Tensor:
    """Return the image in grey, `[H, W]`, with mean 0 and standard deviation 1; all 0 for a flat image."""
    levels = grey(image)
    # In float32 the grey levels of a flat image may differ in the last bit.
    return (levels - levels.mean()) / levels.std(correction=0).clamp(min=1e-6)
