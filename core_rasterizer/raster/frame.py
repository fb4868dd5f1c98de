"""Arrays that a render keeps for its backward pass, and their reuse."""

from __future__ import annotations

import weakref

import torch

from ..device import Device, LaunchPlan, Scratch
from .images import Coverage, Images
from .request import RenderRequest


class Frame:
    """Arrays of one render for its backward pass; reused by later renders."""

    def __init__(self, device: Device) -> None:
        self.arrays = Scratch(device)
        self.lists = LaunchPlan()
        """Builds the lists of this frame."""
        self.request: RenderRequest
        self.tiles = (0, 0)
        self.pair_limit = 0
        self.visible = 0
        self.pairs = 0
        self.reserved_for: object = None
        """What the arrays are large enough for; None: they must be reserved."""
        self._device = device
        self._coverage: weakref.ref[Coverage] | None = None
        self._images: weakref.ref[Images] | None = None
        self._fetched: set[str] = set()

    def new_images(self, dtype: torch.dtype) -> Images:
        """Allocate the images of the request."""
        camera = self.request.camera
        images = Images(self._device, self.arrays, (camera.height, camera.width), dtype)
        self._images, self._fetched = weakref.ref(images), images.fetched
        return images

    def coverage(self, count: int) -> Coverage:
        """Coverage of the render's `count` Gaussians; stays valid while it is referenced."""
        coverage = Coverage(self.arrays["slot_count"], count)
        self._coverage = weakref.ref(coverage)
        return coverage

    def release(self) -> None:
        """Prepare for reuse: results of the last render that are still referenced keep their arrays."""
        if self._coverage is not None and self._coverage() is not None:
            self.arrays.give_away("slot_count")
            self.reserved_for = None
        images = None if self._images is None else self._images()
        self.arrays.give_away(*(self._fetched if images is None else images.names))
        self._coverage = self._images = None


class Lease:
    """Takes a frame from a pool and returns it when the lease is freed."""

    def __init__(self, pool: list[Frame], device: Device) -> None:
        self._pool = pool
        self.frame = pool.pop() if pool else Frame(device)
        self.frame.release()

    def __del__(self) -> None:
        self._pool.append(self.frame)
