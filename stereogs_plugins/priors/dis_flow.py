"""`dis_flow`: optical flow by dense inverse search; needs no model file.

Patches of one image are searched in the other from coarse to fine and the resulting flow is refined (Kroeger
et al., ECCV 2016, OpenCV's implementation). A substitute for a flow network without weights.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from registry import Register, Settings, hookimpl
from registry.priors import OpticalFlowPrior
from registry.toolkit.views import flow_cycle_error, flow_in_size

if TYPE_CHECKING:
    from typing import Any

    import numpy as np
    from numpy.typing import NDArray
    from torch import Tensor

SMALLEST = 16
"""Least shorter side in pixels: two patches. On smaller images OpenCV 5.0 fails or crashes."""


class DisFlowSettings(Settings):
    max_cycle_error: float | None = Field(1.0, gt=0)
    """Largest distance in pixels between a pixel and the end of the flow there and back; larger ones are
    unknown. null keeps all vectors, including those of occluded pixels."""


class DisFlow(OpticalFlowPrior[DisFlowSettings]):
    """OpenCV's DIS optical flow, on one thread because the result depends on the number of threads."""

    def fingerprint(self) -> str:
        """Version of OpenCV."""
        import cv2

        return f"OpenCV {cv2.__version__}"

    def estimate(self, first: Tensor, second: Tensor) -> Tensor:
        """Flow `[H, W, 2]` in pixels; not finite where it fails the cycle check."""
        import torch

        height, width = first.shape[:2]
        if min(height, width, *second.shape[:2]) < SMALLEST:
            return torch.full((height, width, 2), torch.nan)
        here, there = _grey(first, (width, height)), _grey(second, (width, height))
        there_from_here, here_from_there = self._both_ways(here, there)
        flow = torch.from_numpy(there_from_here).double()
        limit = self.settings.max_cycle_error
        if limit is not None:
            flow[flow_cycle_error(flow, torch.from_numpy(here_from_there)) > limit] = torch.nan
        return flow_in_size(flow, (second.shape[0], second.shape[1])).float()

    @staticmethod
    def _both_ways(
        here: NDArray[np.uint8], there: NDArray[np.uint8]
    ) -> tuple[NDArray[Any], NDArray[Any]]:
        import cv2
        import numpy as np

        search = cv2.DISOpticalFlow.create(cv2.DISOpticalFlow_PRESET_MEDIUM)
        threads = cv2.getNumThreads()
        cv2.setNumThreads(1)
        try:
            start = np.zeros((*here.shape, 2), np.float32)
            return search.calc(here, there, start.copy()), search.calc(there, here, start)
        finally:
            cv2.setNumThreads(threads)


def _grey(image: Tensor, size: tuple[int, int]) -> NDArray[np.uint8]:
    """Grey image in 0..255, resized to (width, height)."""
    import cv2
    import numpy as np

    from registry.toolkit.images import grey

    brightness = (255 * grey(image).clamp(0, 1)).round().numpy().astype(np.uint8)
    if (brightness.shape[1], brightness.shape[0]) == size:
        return brightness
    return cv2.resize(brightness, size, interpolation=cv2.INTER_AREA).astype(np.uint8)


@hookimpl
def stereogs_register_priors(register: Register[DisFlow]) -> None:
    register("dis_flow", DisFlow)
