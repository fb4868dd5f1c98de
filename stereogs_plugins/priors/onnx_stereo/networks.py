"""Stereo networks of one ONNX graph, or of two with a correlation volume between them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch.nn.functional import normalize

from registry import PluginError
from registry.toolkit.images import grey
from registry.toolkit.networks import OnnxModel

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from torch import Tensor

    from registry.toolkit.networks.image_fitting import FrozenShape

    from .families import StereoFamily

_GREY, _COLOUR = 2, 6
"""Channels of a stacked pair of grey or coloured images."""
_REDUCTION = 4
"""Factor from the correlation volume's grid to the image's size."""
_VOLUME = "gwc_volume"
_FEATURES = ("features_left_04", "features_right_04")


class StereoNetwork:
    """Base of the networks.

    Args:
        models: the graphs; the first takes the images, the last returns the disparity.
        image: name of an image input `[N, C, H, W]`.
        max_disparity: see `StereoFamily`.

    Attributes:
        last: graph that returns the disparity.
        frozen: fixed height and width of the images; None where dynamic.
        batchable: True if one call can take several pairs.
    """

    def __init__(
        self, models: Sequence[OnnxModel], image: str, max_disparity: float | None
    ) -> None:
        self.last = models[-1]
        shape = models[0].input(image).shape
        self.frozen: FrozenShape = (shape[2], shape[3])
        self.batchable = all(spec.shape[0] is None for model in models for spec in model.inputs)
        self.max_disparity = max_disparity

    def __call__(self, left: Tensor, right: Tensor) -> dict[str, Tensor]:
        """Outputs of the last graph for pairs `[N, 3, H, W]` in the network's value range."""
        raise NotImplementedError


class OneGraph(StereoNetwork):
    """A graph from two images to the disparity.

    Raises:
        PluginError: the graph lacks such inputs or outputs.
    """

    def __init__(self, model: OnnxModel, family: StereoFamily) -> None:
        self._left, self._right = image_inputs(model, family)
        super().__init__([model], self._left, family.max_disparity)

    def __call__(self, left: Tensor, right: Tensor) -> dict[str, Tensor]:
        """See `StereoNetwork`."""
        return self.last.run({self._left: left, self._right: right})


class StackedGraph(StereoNetwork):
    """A graph that takes both images in one tensor, left channels first, as circulating HITNet files do.

    Images are grey if the graph takes two channels.

    Raises:
        PluginError: the graph has several inputs, or takes neither 2 nor 6 channels.
    """

    def __init__(self, model: OnnxModel, family: StereoFamily) -> None:
        pair = model.input()
        if len(pair.shape) != 4 or pair.shape[1] not in (_GREY, _COLOUR):
            raise PluginError(
                f"the input {pair} is not a stacked pair; expected [N, 2, H, W] or [N, 6, H, W]",
                where=str(model.path),
                fix="set `family`, or `stacked: false`, for a graph with separate image inputs",
            )
        self._input, self._grey = pair.name, pair.shape[1] == _GREY
        super().__init__([model], pair.name, family.max_disparity)

    def __call__(self, left: Tensor, right: Tensor) -> dict[str, Tensor]:
        """See `StereoNetwork`."""
        images = [left, right]
        if self._grey:
            images = [grey(image.movedim(1, -1))[:, None] for image in images]
        return self.last.run({self._input: torch.cat(images, dim=1)})


class TwoGraphs(StereoNetwork):
    """A graph from two images to features, and one from features and correlation volume to the disparity.

    The volume is computed here because plain ONNX operators cannot express it. The second graph takes
    `gwc_volume` `[N, groups, max_disparity / 4, H / 4, W / 4]` and any outputs of the first.

    Args:
        first, second: the graphs.
        family: gives the names, and the number of candidates if that is dynamic in the second graph.
        groups: number of groups, if that is dynamic in the second graph.
        normalized: see `group_correlation`.

    Raises:
        PluginError: the graphs do not match.
    """

    def __init__(
        self,
        first: OnnxModel,
        second: OnnxModel,
        family: StereoFamily,
        *,
        groups: int,
        normalized: bool,
    ) -> None:
        self._first = first
        self._left, self._right = image_inputs(first, family)
        self._normalized = normalized
        for name in _FEATURES:
            first.output(name)
        offered = {spec.name for spec in first.outputs}
        self._passed = [spec.name for spec in second.inputs if spec.name != _VOLUME]
        missing = [name for name in self._passed if name not in offered]
        if missing:
            raise PluginError(
                f"the second graph takes {missing}, which the first does not return",
                where=f"{first.path} and {second.path}",
                fix="use two files of one export",
            )
        shape = second.input(_VOLUME).shape
        if len(shape) != 5:
            raise PluginError(
                f"{_VOLUME!r} has {len(shape)} dimensions, expected "
                "[N, groups, candidates, H / 4, W / 4]",
                where=str(second.path),
            )
        self._groups = shape[1] or groups
        self._candidates = shape[2] or round((family.max_disparity or 0) / _REDUCTION)
        if self._candidates < 1:
            raise PluginError(
                "neither the graph nor the settings give the number of disparities",
                where=str(second.path),
                fix="set `max_disparity`",
            )
        super().__init__([first, second], self._left, float(self._candidates * _REDUCTION))

    def __call__(self, left: Tensor, right: Tensor) -> dict[str, Tensor]:
        """See `StereoNetwork`.

        Raises:
            PluginError: the channels of the features cannot be split into the groups.
        """
        answers = self._first.run({self._left: left, self._right: right})
        return self.last.run(
            {_VOLUME: self._volume(answers), **{name: answers[name] for name in self._passed}}
        )

    def _volume(self, answers: Mapping[str, Tensor]) -> Tensor:
        left, right = (answers[name] for name in _FEATURES)
        if left.ndim != 4 or left.shape != right.shape or left.shape[1] % self._groups:
            raise PluginError(
                f"the features have the shapes {list(left.shape)} and {list(right.shape)}, "
                f"expected two equal ones [N, C, H / 4, W / 4], C a multiple of {self._groups}",
                where=str(self._first.path),
                fix="set `groups` as in the export",
            )
        return group_correlation(
            left,
            right,
            groups=self._groups,
            candidates=self._candidates,
            normalized=self._normalized,
        )


def group_correlation(
    left: Tensor, right: Tensor, *, groups: int, candidates: int, normalized: bool
) -> Tensor:
    """Group-wise correlation of left(x) and right(x - k) for shifts k (Guo et al., CVPR 2019, section 3.2).

    Args:
        left, right: `[N, C, H, W]` features; C is a multiple of `groups`.
        groups: number of groups of consecutive channels.
        candidates: number of shifts 0, 1, ..., in columns of the feature map.
        normalized: scale each group's vector to unit length, so that the product is a cosine.

    Returns:
        `[N, groups, candidates, H, W]` float32: dot products; 0 where x < k.
    """
    count, channels, height, width = left.shape
    split = (count, groups, channels // groups, height, width)
    left, right = left.reshape(split), right.reshape(split)
    if normalized:
        left, right = normalize(left, dim=2), normalize(right, dim=2)
    volume = left.new_zeros(count, groups, candidates, height, width)
    for shift in range(min(candidates, width)):
        product = left[..., shift:] * right[..., : width - shift]
        volume[:, :, shift, :, shift:] = product.sum(dim=2)
    return volume


def image_inputs(model: OnnxModel, family: StereoFamily) -> tuple[str, str]:
    """Names of the inputs for the left and the right image.

    Raises:
        PluginError: the graph lacks these names, has fewer than two inputs, or they are not images.
    """
    if len(model.inputs) < 2:
        raise PluginError(
            f"the graph has {len(model.inputs)} input, a stereo pair needs two",
            where=str(model.path),
            fix="use the ONNX file of a stereo network; set `stacked` if its input takes both images",
        )
    specs = [
        model.inputs[index] if name is None else model.input(name)
        for index, name in enumerate((family.left, family.right))
    ]
    for spec in specs:
        if len(spec.shape) != 4 or spec.shape[1] not in (None, 3):
            raise PluginError(
                f"the input {spec} is not an image; expected [N, 3, H, W]",
                where=str(model.path),
                fix="set `left` and `right` to the image inputs",
            )
    return specs[0].name, specs[1].name
