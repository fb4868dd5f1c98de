"""`dis_flow`: optical flow by dense inverse search, without any model file.

Patches of one image are looked for in the other from coarse to fine, and the field that they vote for is
refined (Kroeger et al., ECCV 2016), in OpenCV's implementation. It stands in where a method asks for a
flow network and no weights are at hand.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from registry import OpticalFlowPrior, Register, Settings, hookimpl

if TYPE_CHECKING:
    from typing import Any

    import numpy as np
    from numpy.typing import NDArray
    from torch import Tensor

SMALLEST = 16
"""Pixels of the shorter side: two patches. On smaller images OpenCV 5.0 fails, or ends the process."""


class DisFlowSettings(Settings):
    max_cycle_error: float | None = Field(1.0, gt=0)
    """A vector is unknown where the flow back ends farther than this from where it began, pixels; null
    keeps all, also those of pixels that the other image does not show."""


class DisFlow(OpticalFlowPrior[DisFlowSettings]):
    """OpenCV's DIS optical flow, on one thread: its answer depends on how many there are."""

    def fingerprint(self) -> str:
        """OpenCV's version."""
        import cv2

        return f"OpenCV {cv2.__version__}"

    def estimate(self, first: Tensor, second: Tensor) -> Tensor:
        """Flow `[H, W, 2]`, pixels; not finite where it does not come back."""
        import torch

        height, width = first.shape[:2]
        if min(height, width, *second.shape[:2]) < SMALLEST:
            return torch.full((height, width, 2), torch.nan)
        here, there = _grey(first, (width, height)), _grey(second, (width, height))
        there_from_here, here_from_there = self._both_ways(here, there)
        flow = torch.from_numpy(there_from_here).double()
        limit = self.settings.max_cycle_error
        if limit is not None:
            flow[_cycle_error(flow, torch.from_numpy(here_from_there)) > limit] = torch.nan
        # `second` was looked at in the size of `first`.
        u, v = _pixel_centers(height, width)
        here_uv = torch.stack([u, v], dim=2)
        factors = here_uv.new_tensor([second.shape[1] / width, second.shape[0] / height])
        return ((here_uv + flow) * factors - here_uv).float()

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
    """Brightness in 0..255 at a size (width, height)."""
    import cv2
    import numpy as np

    from registry import grey

    brightness = (255 * grey(image).clamp(0, 1)).round().numpy().astype(np.uint8)
    if (brightness.shape[1], brightness.shape[0]) == size:
        return brightness
    return cv2.resize(brightness, size, interpolation=cv2.INTER_AREA).astype(np.uint8)


def _cycle_error(flow: Tensor, back: Tensor) -> Tensor:
    """Pixels `[H, W]` between where a pixel is and where it comes back to; infinite outside."""
    import torch
    from torch.nn.functional import grid_sample

    height, width = flow.shape[:2]
    u, v = _pixel_centers(height, width)
    ends = torch.stack([u, v], dim=2) + flow
    size = flow.new_tensor([width, height])
    inside = ((ends >= 0) & (ends <= size)).all(dim=2)
    sampled = grid_sample(
        back.double().permute(2, 0, 1)[None],
        (2 * ends / size - 1)[None],
        align_corners=False,
        padding_mode="border",
    )[0].permute(1, 2, 0)
    error: Tensor = (flow + sampled).norm(dim=2).where(inside, torch.inf)
    return error


def _pixel_centers(height: int, width: int) -> tuple[Tensor, Tensor]:
    import torch

    v, u = torch.meshgrid(
        torch.arange(height, dtype=torch.float64) + 0.5,
        torch.arange(width, dtype=torch.float64) + 0.5,
        indexing="ij",
    )
    return u, v


@hookimpl
def stereogs_register_priors(register: Register[DisFlow]) -> None:
    register("dis_flow", DisFlow)
