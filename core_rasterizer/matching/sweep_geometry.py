"""Planes of a sweep, and their projection into source views."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from ..camera import Camera
from ..device import Device, DeviceArray
from .semi_global import empty_volume, padded_planes

SOURCE_MACROS = {"SOURCE_NUMBERS": 12, "SOURCE_LAYOUT": 3}
"""Row lengths of both results of `SweepGeometry.sources`, for the kernels."""


class SweepGeometry:
    """Cameras and planes on a device.

    Args:
        device: where the sweep runs.
        cameras: of any sizes and principal points.
        starts: offset of each view's image or features in the array of all views.
        inverse_depths: `[P]` > 0; 1 / z-depth of the planes in the reference camera, world units^-1.

    Raises:
        ValueError: `inverse_depths` is empty.
    """

    def __init__(
        self,
        device: Device,
        cameras: Sequence[Camera],
        starts: Sequence[int],
        inverse_depths: Tensor,
    ) -> None:
        if not len(inverse_depths):
            raise ValueError("a plane sweep needs at least one plane")
        self._device, self._cameras, self._starts = device, tuple(cameras), tuple(starts)
        self.planes = padded_planes(len(inverse_depths))
        # Padding planes have a depth at which every test for visibility is false.
        padded = torch.full((self.planes,), float("nan"))
        padded[: len(inverse_depths)] = inverse_depths
        self.inverse_depths = DeviceArray(device, (self.planes,))
        self.inverse_depths.write(padded)

    def empty_volume(self, reference: int) -> DeviceArray:
        """Allocate one view's costs, uint8 `[H, W, D]`.

        Raises:
            MemoryBudgetError: see `semi_global.empty_volume`.
        """
        camera = self._cameras[reference]
        return empty_volume(self._device, camera.height, camera.width, self.planes)

    def sources(self, reference: int, sources: Sequence[int]) -> tuple[DeviceArray, DeviceArray]:
        """Projections from the reference view to the source views.

        Returns:
            numbers: float32 `[S, 12]`: A = K_s R K_r^-1 row by row, then b = K_s t. The pixel x at
                inverse depth w appears at A x + w b, homogeneous.
            layout: int32 `[S, 3]`: start, width and height.

        Raises:
            ValueError: `sources` is empty.
        """
        if not sources:
            raise ValueError("a plane sweep needs at least one source view")
        numbers_length, layout_length = SOURCE_MACROS.values()
        numbers = DeviceArray(self._device, (len(sources), numbers_length))
        layout = DeviceArray(self._device, (len(sources), layout_length), torch.int32)
        here = self._cameras[reference]
        for row, index in enumerate(sources):
            there = self._cameras[index]
            turned, moved = plane_transfer(here, there)
            numbers.write(torch.cat([turned.flatten(), moved]), row, row + 1)
            place = (self._starts[index], there.width, there.height)
            layout.write(torch.tensor(place), row, row + 1)
        return numbers, layout


def plane_transfer(reference: Camera, source: Camera) -> tuple[Tensor, Tensor]:
    """A `[3, 3]` and b `[3]`, float64: pixel x at depth z appears in `source` at A x + b / z."""
    relative = source.world_to_camera @ reference.camera_to_world
    turned = source.intrinsics @ relative[:3, :3] @ torch.linalg.inv(reference.intrinsics)
    return turned, source.intrinsics @ relative[:3, 3]


def seen_by_any(depth: Tensor, reference: Camera, sources: Sequence[Camera]) -> Tensor:
    """Which pixels' points project into the image of a source view.

    Args:
        depth: `[H, W]` z-depth in the reference camera, > 0.

    Returns:
        `[H, W]` bool. Occlusion is not tested.
    """
    x, y = reference.pixel_centers()
    seen = torch.zeros_like(depth, dtype=torch.bool)
    for source in sources:
        turned, moved = plane_transfer(reference, source)
        u, v, z = (
            turned[i, 0] * x + turned[i, 1] * y + turned[i, 2] + moved[i] / depth for i in range(3)
        )
        seen |= (z > 0) & (u >= 0) & (v >= 0) & (u <= source.width * z) & (v <= source.height * z)
    return seen
