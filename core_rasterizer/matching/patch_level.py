"""One scale of PatchMatch on a device: images, planes, and the step that improves them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate

import torch
from torch import Tensor

from ..camera import Camera
from ..device import Device, DeviceArray, Program
from .limits import MAX_PATCH_SOURCES
from .sweep_geometry import plane_transfer

GREY_LEVELS = 8191
"""Largest absolute grey value and step between neighbours, as whole numbers."""

_SOURCE_NUMBERS, _SOURCE_LAYOUT = 24, 4
"""Row lengths of the arrays `numbers` and `layout`."""
_KERNELS = tuple(
    f"matching/{name}"
    for name in ("pixel_pairs", "patch_window", "patch_plane", "patch_costs", "patch_match")
)


class PatchLevel:
    """Views at one scale, with one plane per pixel.

    Args:
        device: where to compute.
        images: a grey image `[H, W]` in [0, 1] for each camera, of the camera's size.
        cameras: of any sizes and principal points.
        nearness: (lowest, highest) inverse z-depth of a plane at its pixel, world units^-1.
        radius: of the windows, pixels.
        seed: of the random numbers.
    """

    def __init__(
        self,
        device: Device,
        images: Sequence[Tensor],
        cameras: Sequence[Camera],
        nearness: tuple[float, float],
        *,
        radius: int,
        seed: int,
    ) -> None:
        self._device, self.cameras, self._seed = device, tuple(cameras), seed
        self.nearness = nearness
        self._defines = {
            "RADIUS": radius,
            "LEVELS": GREY_LEVELS,
            "MAX_SOURCES": MAX_PATCH_SOURCES,
            "SOURCE_NUMBERS": _SOURCE_NUMBERS,
            "SOURCE_LAYOUT": _SOURCE_LAYOUT,
        }
        pair_ends = list(accumulate(camera.width * (camera.height + 1) for camera in cameras))
        ends = list(accumulate(camera.width * camera.height for camera in cameras))
        self._pair_starts, self._starts = [0, *pair_ends[:-1]], [0, *ends[:-1]]
        self._pairs = DeviceArray(device, (pair_ends[-1],), torch.int32)
        self._known = DeviceArray(device, (ends[-1],))
        self._greys = [self._load(index, image) for index, image in enumerate(images)]
        self.planes = [DeviceArray(device, (4, c.height, c.width)) for c in cameras]
        self._launches = 0

    def draw(self, view: int) -> None:
        """Set one view's planes to random ones of unknown cost."""
        camera = self.cameras[view]
        self._program().run(
            "draw_planes",
            (-(-camera.width // self._device.lanes), camera.height),
            None,
            planes=self.planes[view],
            key=self._key(view),
            **self._numbers(camera),
        )

    def costs(self, view: int, sources: Sequence[int]) -> Tensor:
        """Costs of one view's planes in other views: `[S, H, W]`, 1 - NCC, or 2 where not visible."""
        camera = self.cameras[view]
        costs = DeviceArray(self._device, (len(sources), camera.height, camera.width))
        self._program().run(
            "plane_costs",
            (-(-camera.width // self._device.lanes), camera.height),
            None,
            costs=costs,
            width=camera.width,
            height=camera.height,
            **self._images(view, sources),
        )
        return costs.read().clone()

    def improve(
        self, view: int, sources: Sequence[int], *, good_cost: float, agreement: float
    ) -> None:
        """Replace every pixel's plane by the best of its own, its neighbours' and random changes.

        Args:
            good_cost: source views of lower cost count as matching.
            agreement: cost per pixel of reprojection error between the view's depth and that last shared
                by the source view (`share_depths`); 0 ignores other depths.
        """
        camera = self.cameras[view]
        arguments = {**self._images(view, sources), **self._numbers(camera), "key": self._key(view)}
        for colour in (0, 1):
            self._program().run(
                "improve_planes",
                (-(-camera.width // (2 * self._device.lanes)), camera.height),
                None,
                good_cost=good_cost,
                agreement=agreement,
                colour=colour,
                **arguments,
            )

    def share_depths(self) -> None:
        """Make the current depths of all views available to the others."""
        depths = [planes.read(0, 1).flatten() for planes in self.planes]
        self._known.write(torch.cat(depths))

    def _load(self, view: int, image: Tensor) -> DeviceArray:
        camera = self.cameras[view]
        size = (camera.height, camera.width)
        levels = DeviceArray(self._device, size)
        centered = image.nan_to_num(0.5).clamp(0, 1) - 0.5
        levels.write((2 * GREY_LEVELS * centered).round())
        program = self._device.program("matching/sweep_images", dtype=torch.float32, RADIUS=1)
        program.run(
            "pack_pairs",
            (camera.width, camera.height + 1),
            None,
            grey=levels,
            pairs=self._pairs,
            width=camera.width,
            height=camera.height,
            start=self._pair_starts[view],
        )
        grey = DeviceArray(self._device, size)
        grey.write(2 * centered)
        return grey

    def _images(self, view: int, sources: Sequence[int]) -> dict[str, DeviceArray | float]:
        """Kernel arguments: the view's planes and image, and what its source views see.

        Projections there and back are `[S, 24]`, offsets and sizes `[S, 4]`; see the kernel.
        """
        here, rows, places = self.cameras[view], [], []
        for index in sources:
            there = self.cameras[index]
            ways = (*plane_transfer(here, there), *plane_transfer(there, here))
            rows.append(torch.cat([part.flatten() for part in ways]))
            size = (there.width, there.height)
            places.append((self._pair_starts[index], *size, self._starts[index]))
        numbers = DeviceArray(self._device, (len(sources), _SOURCE_NUMBERS))
        numbers.write(torch.stack(rows))
        layout = DeviceArray(self._device, (len(sources), _SOURCE_LAYOUT), torch.int32)
        layout.write(torch.tensor(places))
        return {
            "planes": self.planes[view],
            "grey": self._greys[view],
            "pairs": self._pairs,
            "known": self._known,
            "numbers": numbers,
            "layout": layout,
            "sources": len(sources),
        }

    def _numbers(self, camera: Camera) -> dict[str, float]:
        """Kernel arguments: range of depths, and the camera."""
        farthest, nearest = self.nearness
        return {
            "farthest": farthest,
            "nearest": nearest,
            "width": camera.width,
            "height": camera.height,
            "focal_x": camera.fx,
            "focal_y": camera.fy,
            "center_x": camera.cx,
            "center_y": camera.cy,
        }

    def _key(self, view: int) -> int:
        """Key of the random numbers of the next launch."""
        self._launches += 1
        mixed = 0x9E3779B1 * self._seed + 0x85EBCA77 * view + 0xC2B2AE3D * self._launches
        return mixed % 2**32

    def _program(self) -> Program:
        return self._device.program(*_KERNELS, dtype=torch.float32, **self._defines)
