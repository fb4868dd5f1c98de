"""What a render leaves for its backward pass, and how that memory is used again."""

from __future__ import annotations

import weakref

import torch

from ..device import Device, Scratch
from .coverage import Coverage
from .images import KEPT, Images
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
        self._device = device
        self._coverage: weakref.ref[Coverage] | None = None
        self._images: weakref.ref[Images] | None = None

    def new_images(self, dtype: torch.dtype) -> Images:
        """Room for the images of the request."""
        camera = self.request.camera
        images = Images(self._device, self.arrays, (camera.height, camera.width), dtype)
        self._images = weakref.ref(images)
        return images

    def coverage(self, count: int) -> Coverage:
        """Which of so many Gaussians the render shows; right for as long as somebody keeps it."""
        coverage = Coverage(self.arrays["slot_count"], count)
        self._coverage = weakref.ref(coverage)
        return coverage

    def leave(self) -> None:
        """Before the frame is used again: what somebody still keeps of the last render becomes theirs."""
        if self._coverage is not None and self._coverage() is not None:
            self.arrays.give_away("slot_count")
        if self._images is not None and self._images() is not None:
            self.arrays.give_away(*KEPT)
        self._coverage = self._images = None


class Lease:
    """Holds a frame and hands it back to the pool when nobody needs the render any more."""

    def __init__(self, pool: list[Frame], device: Device) -> None:
        self._pool = pool
        self.frame = pool.pop() if pool else Frame(device)
        self.frame.leave()

    def __del__(self) -> None:
        self._pool.append(self.frame)
