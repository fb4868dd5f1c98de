"""Capability `optical_flow`: displacement of each pixel between two images."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, ClassVar

from ..contract.component import SettingsType
from ..contract.maps import Flow
from ..contract.prior import Prior
from ..toolkit.drawing.pictures import nearness_picture
from .cached_estimates import cached, stem
from .checking import check_map

if TYPE_CHECKING:
    from torch import Tensor

    from ..contract.scene import TrainingView


class OpticalFlowPrior(Prior[SettingsType]):
    """A prior that estimates the displacement of each pixel between two images."""

    capability: ClassVar[str] = "optical_flow"

    @abstractmethod
    def estimate(self, first: Tensor, second: Tensor) -> Tensor:
        """Return `[H, W, 2]`: pixel (u, v) of the first image is at (u, v) + flow[v, u] in the second.

        Non-finite values mean unknown.

        Args:
            first, second: `[H, W, 3]` float32 in [0, 1]; their sizes may differ.
        """

    def flow(self, first: Tensor, second: Tensor) -> Flow:
        """Return the flow between two images; not cached.

        Raises:
            PluginError: The estimate has a wrong shape.
        """
        import torch

        with self.context.at_work(), torch.no_grad():
            answer = self.estimate(first, second)
            check_map("flow", answer, first, 2)
        vectors = answer.detach().float()
        valid = torch.isfinite(vectors).all(dim=2)
        return Flow(torch.where(valid[..., None], vectors, 0.0), valid)

    def flow_between(self, first: TrainingView, second: TrainingView) -> Flow:
        """Return the flow between two photographs; cached on disk.

        Raises:
            PluginError: See `flow`.
        """
        found = cached(
            self,
            [first, second],
            [],
            lambda: dict(vars(self.flow(first.image, second.image))),
            lambda answer: {
                f"{stem(first)}_{stem(second)}_length": nearness_picture(
                    answer["vectors"].norm(dim=2), answer["valid"]
                )
            },
        )
        return Flow(found["vectors"], found["valid"])
