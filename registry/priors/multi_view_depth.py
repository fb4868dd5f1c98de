"""Capability `multi_view_depth`: depth of several views with known cameras."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, Any, ClassVar

from ..contract.component import SettingsType
from ..contract.maps import DepthMap
from ..contract.prior import Prior
from ..errors import PluginError
from ..toolkit.drawing.pictures import nearness_picture
from .cached_estimates import cached, stem
from .checking import check_map

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from torch import Tensor

    from ..contract.scene import TrainingView


class MultiViewDepthPrior(Prior[SettingsType]):
    """A prior that estimates the depth of several views jointly, from their images and cameras."""

    capability: ClassVar[str] = "multi_view_depth"

    @abstractmethod
    def estimate(
        self, views: Sequence[TrainingView], bounds: tuple[float, float]
    ) -> list[DepthMap]:
        """Return one depth map per view, in order; unknown depths may be 0 or non-finite.

        Args:
            views: Two or more views of any sizes.
            bounds: (near, far) z-depth of the scene's content, world units.
        """

    def depths(self, views: Sequence[TrainingView], bounds: tuple[float, float]) -> list[DepthMap]:
        """Return one depth map per view; cached on disk.

        Raises:
            PluginError: There are fewer than two views, or the estimate has a wrong length or shape.
        """
        if len(views) < 2:
            raise PluginError(
                f"multi-view depth needs two views, got {len(views)}",
                fix="use more training views, or an initializer without a prior",
            )
        found = cached(
            self,
            views,
            [bounds],
            lambda: self._checked(views, bounds),
            lambda answer: _pictures(answer, views),
        )
        return [_unpack(found, index) for index in range(len(views))]

    def _checked(
        self, views: Sequence[TrainingView], bounds: tuple[float, float]
    ) -> dict[str, Tensor]:
        with self.context.at_work():
            answers = self.estimate(views, bounds)
            if not isinstance(answers, list | tuple):
                raise PluginError(
                    f"the answer is a {type(answers).__name__}, expected a list of depth maps"
                )
            if len(answers) != len(views):
                raise PluginError(f"{len(answers)} depth maps came for {len(views)} views")
            return _pack([_depth_map(a, v) for a, v in zip(answers, views, strict=True)])


def _pictures(answer: Mapping[str, Tensor], views: Sequence[TrainingView]) -> dict[str, Tensor]:
    maps = [_unpack(answer, index) for index in range(len(views))]
    return {
        f"{stem(view)}_depth": nearness_picture(1 / one.depth, one.valid)
        for view, one in zip(views, maps, strict=True)
    }


def _depth_map(answer: Any, view: TrainingView) -> DepthMap:
    import torch

    for name in ("depth", "valid", "confidence"):
        check_map(name, getattr(answer, name, None), view.image)
    depth, confidence = answer.depth.detach().float(), answer.confidence.detach().float()
    valid = answer.valid & torch.isfinite(depth) & (depth > 0) & torch.isfinite(confidence)
    return DepthMap(
        torch.where(valid, depth, 0.0), valid, torch.where(valid, confidence.clamp(0, 1), 0.0)
    )


def _pack(maps: Sequence[DepthMap]) -> dict[str, Tensor]:
    packed = {}
    for index, answer in enumerate(maps):
        packed[f"{index}/depth"] = answer.depth
        packed[f"{index}/valid"] = answer.valid
        packed[f"{index}/confidence"] = answer.confidence
    return packed


def _unpack(found: Mapping[str, Tensor], index: int) -> DepthMap:
    return DepthMap(*(found[f"{index}/{name}"] for name in ("depth", "valid", "confidence")))
