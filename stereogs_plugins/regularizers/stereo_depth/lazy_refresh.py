"""Reuse of stereo disparities until the right image has changed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

if TYPE_CHECKING:
    from collections.abc import Mapping

REDUCTION = 4
"""Side of the blocks, in pixels, whose means are stored and compared."""


@dataclass(frozen=True, eq=False)
class _Answer:
    picture: Tensor
    """`[3, h, w]`, block means of the matched right image."""
    disparity: Tensor
    """`[H, W]`, the resulting disparity."""


class LazyRefresh:
    """The last disparity of each training view and the right image that it was computed from.

    Args:
        threshold: largest change of the right image (mean absolute difference, colours in [0, 1]) at which
            a disparity is reused; 0 disables reuse.

    Attributes:
        asked, reused: number of new disparities, and of reused ones.
    """

    def __init__(self, threshold: float) -> None:
        self._threshold = threshold
        self._answers: dict[str, _Answer] = {}
        self.asked = 0
        self.reused = 0

    def find(self, view: str, right: Tensor) -> Tensor | None:
        """Return the view's disparity if its right image `[H, W, 3]` has changed by at most the threshold."""
        answer = self._answers.get(view)
        if answer is None or self._threshold == 0:
            return None
        if float((_blocks(right) - answer.picture).abs().mean()) > self._threshold:
            return None
        self.reused += 1
        return answer.disparity

    def keep(self, view: str, right: Tensor, disparity: Tensor) -> None:
        """Store a new disparity, replacing the old one."""
        self.asked += 1
        self._answers[view] = _Answer(_blocks(right), disparity)

    def state(self) -> dict[str, Tensor]:
        """Return the state for a checkpoint."""
        state = {"counts": torch.tensor([self.asked, self.reused])}
        for view, answer in self._answers.items():
            state[f"{view}/picture"] = answer.picture
            state[f"{view}/disparity"] = answer.disparity
        return state

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Restore what `state` returned."""
        self.asked, self.reused = state["counts"].tolist()
        views = [key.removesuffix("/picture") for key in state if key.endswith("/picture")]
        self._answers = {
            view: _Answer(state[f"{view}/picture"], state[f"{view}/disparity"]) for view in views
        }


def _blocks(image: Tensor) -> Tensor:
    return avg_pool2d(image.permute(2, 0, 1), REDUCTION, ceil_mode=True)
