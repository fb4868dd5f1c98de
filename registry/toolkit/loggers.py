"""Settings that observers share which log images of the training."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from pydantic import Field

from ..contract.component import Settings
from .drawing.pictures import side_by_side, to_bytes

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from torch import Tensor

    from core_rasterizer import Rendering


class _Iteration(Protocol):
    """The part of `registry.events.IterationDone` that `LoggerSettings` uses."""

    @property
    def iteration(self) -> int: ...
    @property
    def target(self) -> Tensor: ...
    @property
    def rendering(self) -> Rendering: ...


class LoggerSettings(Settings):
    """Settings of observers that log training images."""

    pictures_every: int = Field(500, ge=0)
    """Iterations between two logged images, which show target and render side by side; the logger must be
    due too (`every`). 0 logs no images."""

    def picture(self, done: _Iteration) -> NDArray[np.uint8] | None:
        """Return target and render side by side, `[H, 2 W + gap, 3]`, if an image is due, else None."""
        if not self.pictures_every or done.iteration % self.pictures_every:
            return None
        return to_bytes(side_by_side(done.target, done.rendering.rgb))
