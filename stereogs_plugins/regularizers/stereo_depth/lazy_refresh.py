"""Asks a stereo model again only when the picture that it would be shown has changed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

REDUCTION = 4
"""The picture is kept, and compared, as means of blocks of this many pixels squared."""


@dataclass(frozen=True, eq=False)
class _Answer:
    picture: Tensor
    """`[3, h, w]`, the right image when the model was asked, in blocks."""
    disparity: Tensor
    """`[H, W]`, what came of it."""


class LazyRefresh:
    """Per training view, the last disparity and the right image that it was found with.

    Args:
        threshold: how much the right image may have changed since (mean absolute difference, colours
            in [0, 1]) for the disparity to be used again; 0 never uses one again.

    Attributes:
        asked, reused: how often a new disparity was kept, and how often an old one was given.
    """

    def __init__(self, threshold: float) -> None:
        self._threshold = threshold
        self._answers: dict[str, _Answer] = {}
        self.asked = 0
        self.reused = 0

    def find(self, view: str, right: Tensor) -> Tensor | None:
        """The view's disparity if its right image `[H, W, 3]` is still nearly the same."""
        answer = self._answers.get(view)
        if answer is None or self._threshold == 0:
            return None
        if float((_blocks(right) - answer.picture).abs().mean()) > self._threshold:
            return None
        self.reused += 1
        return answer.disparity

    def keep(self, view: str, right: Tensor, disparity: Tensor) -> None:
        """Remember a new disparity in place of the old one."""
        self.asked += 1
        self._answers[view] = _Answer(_blocks(right), disparity)

    def state(self) -> dict[str, Tensor]:
        """Everything, for a checkpoint."""
        state = {"counts": torch.tensor([self.asked, self.reused])}
        for view, answer in self._answers.items():
            state[f"{view}/picture"] = answer.picture
            state[f"{view}/disparity"] = answer.disparity
        return state

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Take back what `state` returned."""
        self.asked, self.reused = state["counts"].tolist()
        views = [key.removesuffix("/picture") for key in state if key.endswith("/picture")]
        self._answers = {
            view: _Answer(state[f"{view}/picture"], state[f"{view}/disparity"]) for view in views
        }


def _blocks(image: Tensor) -> Tensor:
    return avg_pool2d(image.permute(2, 0, 1), REDUCTION, ceil_mode=True)
