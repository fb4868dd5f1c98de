"""Pictures of training for loggers."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from ...contract.component import Settings
from .pictures import side_by_side, to_bytes

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ...events import IterationDone


class LoggerSettings(Settings):
    pictures_every: int = Field(500, ge=0)
    """Iterations between two pictures, the target beside its render; none where the logger is not due
    (`every`), and none at all with 0."""

    def picture(self, done: IterationDone) -> NDArray[np.uint8] | None:
        """The target and its render side by side, `[H, 2 W + gap, 3]`, if a picture is due; else None."""
        if not self.pictures_every or done.iteration % self.pictures_every:
            return None
        return to_bytes(side_by_side(done.target, done.rendering.rgb))
