"""Stereo networks that take both images as one tensor, as the HITNet files in circulation do."""

from __future__ import annotations

from typing import TYPE_CHECKING

from registry import PluginError
from registry.toolkit.drawing import grey
from registry.toolkit.networks import OnnxModel

from .networks import frozen_size, open_batch

if TYPE_CHECKING:
    from torch import Tensor

    from .families import StereoFamily

_GREY, _COLOUR = 2, 6
"""Channels of the input: of two grey and of two coloured images."""


class StackedGraph:
    """Both images in one tensor, the left one's channels first, grey if the graph takes two channels.

    Raises:
        PluginError: the graph has another number of inputs, or takes neither 2 nor 6 channels.
    """

    def __init__(self, model: OnnxModel, family: StereoFamily) -> None:
        self.last = model
        pair = model.input()
        if len(pair.shape) != 4 or pair.shape[1] not in (_GREY, _COLOUR):
            raise PluginError(
                f"the input {pair} takes no stacked pair; expected [N, 2, H, W] or [N, 6, H, W]",
                where=str(model.path),
                fix="choose a family, or `stacked: false`, for a graph that takes the images apart",
            )
        self._input, self._grey = pair.name, pair.shape[1] == _GREY
        self.frozen = frozen_size(model, pair.name)
        self.batchable = open_batch(model)
        self.max_disparity = family.max_disparity

    def __call__(self, left: Tensor, right: Tensor) -> dict[str, Tensor]:
        """See `StereoNetwork`."""
        import torch

        images = [left, right]
        if self._grey:
            images = [grey(image.movedim(1, -1))[:, None] for image in images]
        return self.last.run({self._input: torch.cat(images, dim=1)})
