"""Capability `matches`: corresponding points of two images."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, Any, ClassVar

from ..contract.component import SettingsType
from ..contract.maps import Matches
from ..contract.prior import Prior
from ..errors import PluginError
from .cached_estimates import cached
from .checking import check_finite

if TYPE_CHECKING:
    from torch import Tensor

    from ..contract.scene import TrainingView


class MatchingPrior(Prior[SettingsType]):
    """A prior that matches points of two images."""

    capability: ClassVar[str] = "matches"

    @abstractmethod
    def estimate(self, first: Tensor, second: Tensor) -> Matches:
        """Return matches in any order; those outside the images will be dropped.

        Args:
            first, second: `[H, W, 3]` float32 in [0, 1]; their sizes may differ.
        """

    def matches(self, first: Tensor, second: Tensor) -> Matches:
        """Return the matches of two images; not cached.

        Raises:
            PluginError: The estimate has wrong types, shapes or non-finite values.
        """
        import torch

        with self.context.at_work(), torch.no_grad():
            answer = self.estimate(first, second)
            _check(answer)
        inside = _inside(answer.first, first) & _inside(answer.second, second)
        return Matches(
            answer.first[inside].float(),
            answer.second[inside].float(),
            answer.scores[inside].float().clamp(0, 1),
        )

    def matches_between(self, first: TrainingView, second: TrainingView) -> Matches:
        """Return the matches of two photographs; cached on disk.

        Raises:
            PluginError: See `matches`.
        """
        found = cached(
            self,
            [first, second],
            [],
            lambda: dict(vars(self.matches(first.image, second.image))),
            lambda answer: {},
        )
        return Matches(found["first"], found["second"], found["scores"])


def _check(answer: Any) -> None:
    from torch import Tensor

    if not isinstance(answer, Matches):
        raise PluginError(f"the answer is a {type(answer).__name__}, expected Matches")
    count = len(answer.scores) if isinstance(answer.scores, Tensor) else 0
    for name, shape in (("first", (count, 2)), ("second", (count, 2)), ("scores", (count,))):
        value = getattr(answer, name)
        if not isinstance(value, Tensor) or tuple(value.shape) != shape:
            got = tuple(value.shape) if isinstance(value, Tensor) else type(value).__name__
            raise PluginError(f"the matches' {name} is {got}, expected a tensor of shape {shape}")
        check_finite(f"matches' {name}", value)


def _inside(points: Tensor, image: Tensor) -> Tensor:
    height, width = image.shape[:2]
    u, v = points.unbind(dim=1)
    return (u >= 0) & (u <= width) & (v >= 0) & (v <= height)
