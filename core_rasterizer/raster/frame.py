"""What a render leaves for its backward pass, and how that memory is used again."""

from __future__ import annotations

from ..device import Device, Scratch
from .request import RenderRequest


class Frame:
    """What the backward pass needs of one render; its arrays are reused by later renders."""

    def __init__(self, device: Device) -> None:
        self.arrays = Scratch(device)
        self.request: RenderRequest
        self.tiles = (0, 0)
        self.pair_limit = 0
        self.visible = 0
        self.pairs = 0


class Lease:
    """Holds a frame and hands it back to the pool when nobody needs the render any more."""

    def __init__(self, pool: list[Frame], device: Device) -> None:
        self._pool = pool
        self.frame = pool.pop() if pool else Frame(device)

    def __del__(self) -> None:
        self._pool.append(self.frame)
