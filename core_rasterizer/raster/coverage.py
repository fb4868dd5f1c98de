"""Which Gaussians a render shows, known on the device and read only when somebody asks."""

from __future__ import annotations

from torch import Tensor

from ..device import DeviceArray


class Coverage:
    """How many tiles each Gaussian of a render covers.

    Args:
        tiles_covered: `[capacity]` int32, or longer; not to be written to while this object lives.
        count: how many Gaussians there are.
    """

    def __init__(self, tiles_covered: DeviceArray, count: int) -> None:
        self._tiles_covered, self._count = tiles_covered, count

    def visible(self) -> Tensor:
        """Which Gaussians cover a tile, bool `[N]`."""
        return self._tiles_covered.read(0, self._count) > 0
