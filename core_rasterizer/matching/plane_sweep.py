"""Plane sweep of posed views by ZNCC, over planes parallel to the image (Collins, CVPR 1996)."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate

import torch
from torch import Tensor

from ..camera import Camera
from ..device import Device, DeviceArray, Program
from .limits import MAX_SWEEP_RADIUS
from .sweep_geometry import SOURCE_MACROS, SweepGeometry


class ZnccSweep:
    """Costs by zero-mean normalized cross-correlation of square windows.

    Windows are cropped at the border of the reference image; source images are padded with their edge
    values. Where an image is flat, ZNCC approaches 0.

    Args:
        device: where to compute.
        images: a grey image `[H, W]` in [0, 1] for each camera, of the camera's size.
        cameras: of any sizes and principal points.
        inverse_depths: `[P]` > 0; 1 / z-depth of the planes in the reference camera, world units^-1.
        radius: of the window, pixels, 1 .. `MAX_SWEEP_RADIUS`.
        noise: standard deviation of grey values that counts as no texture, in (0, 1].
        second_share: weight in [0, 1] of the source view that matches second best; the best has the
            rest. Others have none, because the surface may be hidden from them.

    Raises:
        ValueError: an image has another size than its camera; no plane; the radius or the noise is out
            of range.
    """

    def __init__(
        self,
        device: Device,
        images: Sequence[Tensor],
        cameras: Sequence[Camera],
        inverse_depths: Tensor,
        *,
        radius: int = 2,
        noise: float = 0.001,
        second_share: float = 0.25,
    ) -> None:
        if not 1 <= radius <= MAX_SWEEP_RADIUS:
            raise ValueError(f"the radius is {radius}; it must lie in 1 .. {MAX_SWEEP_RADIUS}")
        if not 0 < noise <= 1:
            raise ValueError(f"the noise is {noise}; it must lie in (0, 1]")
        self._device, self._radius = device, radius
        self._tile = device.profile.sweep_tile
        # So that sums of squares over a window are at most 2^24; see the kernel.
        levels = 2**12 // (2 * radius + 1)
        self._weights = {"noise": (2 * levels * noise) ** 2, "second_share": second_share}
        self._images = device.program("matching/sweep_images", dtype=torch.float32, RADIUS=radius)
        ends = list(accumulate(camera.width * (camera.height + 1) for camera in cameras))
        starts = [0, *ends[:-1]]
        self._geometry = SweepGeometry(device, cameras, starts, inverse_depths)
        self._pairs = DeviceArray(device, (ends[-1],), torch.int32)
        self._greys = [
            self._load(image, camera, start, levels)
            for image, camera, start in zip(images, cameras, starts, strict=True)
        ]

    def costs(self, reference: int, sources: Sequence[int]) -> DeviceArray:
        """The cost of every plane at every pixel of one view.

        Args:
            reference: index of the view.
            sources: indices of the views to compare it with, at least one.

        Returns:
            uint8 `[H, W, D]` as in `semi_global`: 127.5 (1 - ZNCC), and 128 where no source view sees
            the pixel on that plane.

        Raises:
            ValueError: `sources` is empty.
            MemoryBudgetError: see `semi_global.empty_volume`.
        """
        numbers, layout = self._geometry.sources(reference, sources)
        costs = self._geometry.empty_volume(reference)
        grey = self._greys[reference]
        height, width = grey.shape
        size = {"width": width, "height": height}
        windows = DeviceArray(self._device, (height, width, 4))
        self._images.run(
            "describe_windows", (width, height), None, grey=grey, windows=windows, **size
        )
        self._program(len(sources)).run(
            "plane_sweep",
            (
                self._geometry.planes // self._device.profile.sweep_planes,
                -(-width // self._tile[0]),
                -(-height // self._tile[1]),
            ),
            (self._device.profile.sweep_group, 1, 1),
            pairs=self._pairs,
            windows=windows,
            sources=numbers,
            layout=layout,
            inverse_depths=self._geometry.inverse_depths,
            costs=costs,
            **size,
            **self._weights,
        )
        return costs

    def _load(self, image: Tensor, camera: Camera, start: int, levels: int) -> DeviceArray:
        """Return one view's grey levels; also pack them into the array for sampling."""
        height, width = camera.height, camera.width
        if tuple(image.shape) != (height, width):
            raise ValueError(
                f"an image of shape {tuple(image.shape)} has a camera of {width}x{height}"
            )
        grey = DeviceArray(self._device, (height, width))
        grey.write((2 * levels * (image - 0.5)).round())
        place = {"width": width, "height": height, "start": start}
        size = (width, height + 1)
        self._images.run("pack_pairs", size, None, grey=grey, pairs=self._pairs, **place)
        return grey

    def _program(self, sources: int) -> Program:
        return self._device.program(
            "matching/no_contraction",
            "matching/pixel_pairs",
            "matching/plane_sweep",
            dtype=torch.float32,
            SOURCES=sources,
            **SOURCE_MACROS,
            RADIUS=self._radius,
            LANES=self._device.profile.wide_lanes,
            PLANES_PER_ITEM=self._device.profile.sweep_planes,
            TILE_WIDTH=self._tile[0],
            TILE_HEIGHT=self._tile[1],
        )
