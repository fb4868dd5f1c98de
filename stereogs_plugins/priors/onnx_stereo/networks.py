"""A stereo network of one ONNX graph, or of two with a correlation volume between them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from registry import PluginError
from registry.toolkit.networks import OnnxModel

from .group_correlation import group_correlation

if TYPE_CHECKING:
    from collections.abc import Mapping

    from torch import Tensor

    from registry.toolkit.networks.image_fitting import FrozenSize

    from .families import StereoFamily

_REDUCTION = 4
"""The volume of a pair of graphs stands on a grid of a quarter of the image's size."""
_VOLUME = "gwc_volume"
_FEATURES = ("features_left_04", "features_right_04")


class StereoNetwork(Protocol):
    """What a prior needs to know of a network.

    Attributes:
        last: the graph that answers.
        frozen: height and width that the graph insists on; None where it does not.
        batchable: whether several pairs may be asked in one call.
        max_disparity: see `StereoFamily`.
    """

    last: OnnxModel
    frozen: FrozenSize
    batchable: bool
    max_disparity: float | None

    def __call__(self, left: Tensor, right: Tensor) -> dict[str, Tensor]:
        """The graph's outputs for pairs `[N, 3, H, W]` in the network's numbers."""


class OneGraph:
    """Two images in, the disparity out.

    Raises:
        PluginError: the graph has no such inputs or outputs.
    """

    def __init__(self, model: OnnxModel, family: StereoFamily) -> None:
        self.last = model
        self._left, self._right = image_inputs(model, family)
        self.frozen = frozen_size(model, self._left)
        self.batchable = open_batch(model)
        self.max_disparity = family.max_disparity

    def __call__(self, left: Tensor, right: Tensor) -> dict[str, Tensor]:
        """See `StereoNetwork`."""
        return self.last.run({self._left: left, self._right: right})


class TwoGraphs:
    """Features of two images; then, from them and their correlation volume, the disparity.

    Between the graphs stands what neither can hold as plain ONNX operators. The second graph takes
    `gwc_volume` `[N, groups, max_disparity / 4, H / 4, W / 4]` and any of the first one's outputs.

    Args:
        first, second: the graphs.
        family: gives names and the number of candidates if the second graph leaves it open.
        groups: the number of groups if the second graph leaves it open.
        normalized: see `group_correlation`.

    Raises:
        PluginError: the graphs do not fit together.
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
        self._first, self.last = first, second
        self._left, self._right = image_inputs(first, family)
        self._normalized = normalized
        for name in _FEATURES:
            first.output(name)
        offered = {spec.name for spec in first.outputs}
        self._passed = [spec.name for spec in second.inputs if spec.name != _VOLUME]
        strange = [name for name in self._passed if name not in offered]
        if strange:
            raise PluginError(
                f"the second graph wants {strange}, which the first does not answer",
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
                "the number of shifts to try is known neither from the graph nor the settings",
                where=str(second.path),
                fix="set `max_disparity`",
            )
        self.max_disparity: float | None = float(self._candidates * _REDUCTION)
        self.frozen = frozen_size(first, self._left)
        self.batchable = open_batch(first) and open_batch(second)

    def __call__(self, left: Tensor, right: Tensor) -> dict[str, Tensor]:
        """See `StereoNetwork`.

        Raises:
            PluginError: features whose channels cannot be split into the groups.
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


def image_inputs(model: OnnxModel, family: StereoFamily) -> tuple[str, str]:
    """The names of the left and the right image's input.

    Raises:
        PluginError: the graph has none of that name, fewer than two, or no images.
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
                f"the input {spec} takes no images; expected [N, 3, H, W]",
                where=str(model.path),
                fix="name the right inputs with `left` and `right`",
            )
    return specs[0].name, specs[1].name


def frozen_size(model: OnnxModel, name: str) -> FrozenSize:
    """Height and width that an input `[N, 3, H, W]` insists on."""
    shape = model.input(name).shape
    return shape[2], shape[3]


def open_batch(model: OnnxModel) -> bool:
    """Whether every input takes any number of items."""
    return all(spec.shape[0] is None for spec in model.inputs)
