"""Structure-from-motion points, and those of them that a sparse-view run may know.

Their positions were estimated from all photographs, test views among them; keeping only points
that the training views see removes most of that knowledge but not all of it. The `sfm` initializer
with `source: triangulate` starts from the training photographs alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ....contract.scene import PointCloud
from ....errors import SceneError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

MIN_TRAINING_OBSERVATIONS = 2
"""A point that two training views see could have been triangulated from them; one view cannot."""
POINTS_FIX = "restore the file, or set `points: false` to do without it"


@dataclass(frozen=True)
class Tracks:
    """Points and the photographs that see them.

    Args:
        positions: `[P, 3]` world units.
        colors: `[P, 3]`.
        lengths: `[P]`, observations of each point.
        images: `[sum of lengths]`, 0-based indices of sorted photographs, track after track.
    """

    positions: NDArray[np.float32]
    colors: NDArray[np.uint8]
    lengths: NDArray[np.int64]
    images: NDArray[np.int64]

    def seen_by(self, training: list[int]) -> PointCloud | None:
        """The points that at least two of the training views see; None if there are none."""
        import numpy as np
        import torch

        owner = np.repeat(np.arange(len(self.lengths)), self.lengths)
        pairs = np.unique(np.stack([owner, self.images])[:, np.isin(self.images, training)], axis=1)
        seen = np.bincount(pairs[0], minlength=len(self.lengths))
        keep = seen >= min(MIN_TRAINING_OBSERVATIONS, len(training))
        if not keep.any():
            return None
        return PointCloud(
            positions=torch.from_numpy(self.positions[keep]),
            colors=torch.from_numpy(self.colors[keep].astype(np.float32) / 255),
        )

    def check(self, image_count: int, where: str) -> None:
        """Refuse tracks that do not fit together.

        Raises:
            SceneError: says what does not fit.
        """
        import numpy as np

        count = len(self.lengths)
        problem = ""
        if self.positions.shape != (count, 3) or self.colors.shape != (count, 3):
            problem = (
                f"positions {self.positions.shape}, colours {self.colors.shape} and "
                f"track lengths {self.lengths.shape} do not belong together"
            )
        elif self.lengths.ndim != 1 or self.images.ndim != 1:
            problem = f"the tracks have shape {self.images.shape}, not one dimension"
        elif (self.lengths < 0).any() or self.lengths.sum() != len(self.images):
            problem = (
                f"the track lengths add up to {self.lengths.sum()}, "
                f"but the tracks have {len(self.images)} entries"
            )
        elif count and len(self.images) and not _within(self.images, image_count):
            problem = f"a track names an image that is not one of the {image_count}"
        elif not np.isfinite(self.positions).all():
            row = int(np.flatnonzero(~np.isfinite(self.positions).all(axis=1))[0])
            problem = f"point {row} is not finite"
        if problem:
            raise SceneError(
                f"the points file is inconsistent: {problem}", where=where, fix=POINTS_FIX
            )


def _within(indices: NDArray[np.int64], count: int) -> bool:
    return bool(indices.min() >= 0 and indices.max() < count)
