"""Depth and normal of every pixel of posed views, by PatchMatch over slanted planes.

Planes spread over a checkerboard (Gipuma: Galliani et al., ICCV 2015) from the best of eight regions
about a pixel to views chosen for each pixel (ACMH and ACMM: Xu and Tao, CVPR 2019). Windows are compared
by bilaterally weighted correlation (COLMAP: Schönberger et al., ECCV 2016), from coarse images to fine
ones, and depths of different views are drawn towards each other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from ..camera import Camera
from ..device import Device
from .limits import MOST_PATCH_SOURCES
from .patch_level import PatchLevel

SMALLEST_SIDE = 24
"""Pixels; a scale whose images are smaller in one direction is left out, but for the finest."""


@dataclass(frozen=True)
class Round:
    """What is done with every view before depths are shared again.

    Args:
        shrink: the images are so many times smaller than given.
        steps: how often every plane is improved.
        agreement: cost of a pixel by which views disagree; see `PatchLevel.improve`.
    """

    shrink: int
    steps: int
    agreement: float


SCHEDULE = (
    Round(4, 8, 0.0),
    Round(4, 3, 0.05),
    Round(2, 3, 0.05),
    Round(1, 2, 0.05),
    Round(1, 1, 0.05),
)
"""At first without other views' depths, which are random; most of the search is done where it is cheap."""


@dataclass(frozen=True, eq=False)
class PlaneMap:
    """What is seen at each pixel of a view.

    Args:
        depth: `[H, W]` float32 z-depth, world units, > 0.
        normal: `[H, W, 3]` float32 in the camera's axes, unit length, towards the camera.
        cost: `[H, W]` float32, 0 = best: 1 - NCC and the disagreement, over the views that count.
    """

    depth: Tensor
    normal: Tensor
    cost: Tensor


class PatchMatch:
    """Planes for all views of a set.

    Args:
        device: where to compute.
        images: a grey image `[H, W]` in [0, 1] for each camera, of the camera's size.
        cameras: of any sizes and principal points.
        bounds: (near, far) z-depth between which surfaces are looked for, world units, 0 < near < far.
        radius: of the windows, pixels.
        seed: of the random numbers; the same seed and device give the same bits.

    Raises:
        ValueError: an image is not of its camera's size, or the bounds hold no depth.
    """

    def __init__(
        self,
        device: Device,
        images: Sequence[Tensor],
        cameras: Sequence[Camera],
        bounds: tuple[float, float],
        *,
        radius: int = 3,
        seed: int = 0,
    ) -> None:
        near, far = bounds
        if not 0 < near < far < math.inf:
            raise ValueError(f"the bounds are {bounds}; they must be 0 < near < far")
        for image, camera in zip(images, cameras, strict=True):
            if tuple(image.shape) != (camera.height, camera.width):
                raise ValueError(
                    f"an image of shape {tuple(image.shape)} has a camera of "
                    f"{camera.width}x{camera.height}"
                )
        smallest = min(min(camera.width, camera.height) for camera in cameras)
        self._schedule = [
            r for r in SCHEDULE if r.shrink == 1 or smallest >= SMALLEST_SIDE * r.shrink
        ]
        if self._schedule[0].agreement:  # nothing is known yet that views could agree with
            self._schedule.insert(0, Round(self._schedule[0].shrink, SCHEDULE[0].steps, 0.0))
        self._levels = {}
        for shrink in {r.shrink: None for r in self._schedule}:
            smaller = [_shrunk(camera, shrink) for camera in cameras]
            self._levels[shrink] = PatchLevel(
                device,
                [_resized(image, c) for image, c in zip(images, smaller, strict=True)],
                smaller,
                (1 / far, 1 / near),
                radius=radius,
                seed=seed,
            )

    def maps(self, sources: Sequence[Sequence[int]]) -> list[PlaneMap]:
        """A plane for every pixel of every view.

        Args:
            sources: for each view the indices of those to compare it with, one to
                `MOST_PATCH_SOURCES`.

        Raises:
            ValueError: a view has no source or too many.
        """
        for index, others in enumerate(sources):
            if not 1 <= len(others) <= MOST_PATCH_SOURCES:
                raise ValueError(
                    f"view {index} has {len(others)} source views; 1 to {MOST_PATCH_SOURCES} are allowed"
                )
        level = self._start(sources)
        for stage in self._schedule:
            if level is not self._levels[stage.shrink]:
                level = self._refined(level, self._levels[stage.shrink])
            level.share_depths()
            for view, others in enumerate(sources):
                for step in range(stage.steps):
                    level.improve(
                        view,
                        others,
                        good_cost=0.8 * math.exp(-(step**2) / 90),
                        agreement=stage.agreement,
                    )
        return [_plane_map(p.read(), c) for p, c in zip(level.planes, level.cameras, strict=True)]

    def _start(self, sources: Sequence[Sequence[int]]) -> PatchLevel:
        """The coarsest level with random planes, each as good as its two best views say."""
        level = self._levels[self._schedule[0].shrink]
        for view, others in enumerate(sources):
            level.draw(view)
            best = level.costs(view, others).sort(dim=0).values[:2].mean(dim=0)
            level.planes[view].write(best[None], 3, 4)
        return level

    def _refined(self, coarse: PatchLevel, fine: PatchLevel) -> PatchLevel:
        """The finer level with the planes of the coarser one."""
        for view, camera in enumerate(fine.cameras):
            planes = _upsampled(coarse.planes[view].read(), camera)
            planes[0].clamp_(*fine.nearness)
            fine.planes[view].write(planes)
        return fine


def _shrunk(camera: Camera, shrink: int) -> Camera:
    return camera.resized(-(-camera.width // shrink), -(-camera.height // shrink))


def _resized(image: Tensor, camera: Camera) -> Tensor:
    """The mean over the area of each pixel of a smaller image."""
    size = (camera.height, camera.width)
    return torch.nn.functional.adaptive_avg_pool2d(image[None, None].double(), size)[0, 0].float()


def _upsampled(planes: Tensor, camera: Camera) -> Tensor:
    """Planes `[4, H, W]` for a larger image of the same view: those of the pixel that covers each one."""
    height, width = planes.shape[1:]
    u, v = camera.pixel_centers()
    u, v = u * width / camera.width, v * height / camera.height
    column, row = u.long().clamp(max=width - 1), v.long().clamp(max=height - 1)
    nearness, right, down, cost = planes[:, row, column].double()
    nearness = nearness + right * (u - column - 0.5) + down * (v - row - 0.5)
    steps = right * width / camera.width, down * height / camera.height
    return torch.stack([nearness, *steps, cost])


def _plane_map(planes: Tensor, camera: Camera) -> PlaneMap:
    nearness, right, down, cost = planes.double()
    u, v = camera.pixel_centers()
    x, y = camera.fx * right, camera.fy * down
    z = nearness - right * (u - camera.cx) - down * (v - camera.cy)
    normal = -torch.nn.functional.normalize(torch.stack([x, y, z], dim=-1), dim=-1)
    return PlaneMap((1 / nearness).float(), normal.float(), cost.float())
