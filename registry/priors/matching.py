"""Points of two images that show the same."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, Any, ClassVar

from ..contract.component import SettingsType
from ..contract.maps import Matches
from ..contract.prior import Prior
from ..errors import PluginError
from .checking import check_finite
from .remembering import remembered

if TYPE_CHECKING:
    from torch import Tensor

    from ..contract.scene import TrainingView


class MatchingPrior(Prior[SettingsType]):
    """Points of two images that show the same."""

    capability: ClassVar[str] = "matches"

    @abstractmethod
    def estimate(self, first: Tensor, second: Tensor) -> Matches:
        """Return the matches, in any order; those outside the images are left out.

        Args:
            first, second: `[H, W, 3]` float32 in [0, 1]; their sizes may differ.
        """

    def matches(self, first: Tensor, second: Tensor) -> Matches:
        """The matches of any two images; not kept.

        Raises:
            PluginError: points, scores or their numbers that do not fit, or are not finite.
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
        """The matches of two photographs; what was asked before is remembered.

        Raises:
            PluginError: see `matches`.
        """
        found = remembered(
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
