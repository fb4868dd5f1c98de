"""Depth and normal of every pixel of posed views, by PatchMatch over slanted planes.

Planes propagate on a checkerboard (Gipuma: Galliani et al., ICCV 2015) from eight regions around a pixel,
with views selected per pixel (ACMH and ACMM: Xu and Tao, CVPR 2019). Windows are compared by bilaterally
weighted correlation (COLMAP: Schönberger et al., ECCV 2016), from coarse to fine images, with a cost for
depths that disagree between views.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from ..camera import Camera
from ..device import Device
from .limits import MAX_PATCH_SOURCES
from .patch_level import PatchLevel

MIN_SIDE = 24
"""Pixels; scales with smaller images are skipped, except the finest."""


@dataclass(frozen=True)
class Round:
    """Steps for every view between two exchanges of depths.

    Args:
        shrink: factor by which the images are reduced.
        steps: number of improvements of every plane.
        agreement: see `PatchLevel.improve`.
    """

    shrink: int
    steps: int
    agreement: float

    @property
    def work(self) -> float:
        """Steps of a view at full size that take as long."""
        return self.steps / self.shrink**2


SCHEDULE = (
    Round(4, 8, 0.0),
    Round(4, 3, 0.05),
    Round(2, 3, 0.05),
    Round(1, 2, 0.05),
    Round(1, 1, 0.05),
)
"""The first round ignores other views' depths, which are random; most of the search is at coarse scale."""


@dataclass(frozen=True, eq=False)
class PlaneMap:
    """Depth, normal and cost at each pixel of a view.

    Args:
        depth: `[H, W]` float32 z-depth, world units, > 0.
        normal: `[H, W, 3]` float32 in the camera's axes, unit length, towards the camera.
        cost: `[H, W]` float32, 0 = best: weighted mean of 1 - NCC plus disagreement.
    """

    depth: Tensor
    normal: Tensor
    cost: Tensor


class PatchMatch:
    """Estimates planes for all views of a set.

    Args:
        device: where to compute.
        images: a grey image `[H, W]` in [0, 1] for each camera, of the camera's size.
        cameras: of any sizes and principal points.
        bounds: (near, far) z-depth of surfaces, world units, 0 < near < far.
        radius: of the windows, pixels.
        seed: of the random numbers; results are bit-identical for the same seed and device.

    Raises:
        ValueError: an image has another size than its camera, or the bounds are invalid.
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
        self._schedule = [r for r in SCHEDULE if r.shrink == 1 or smallest >= MIN_SIDE * r.shrink]
        if self._schedule[0].agreement:  # no depths are known yet
            self._schedule.insert(0, Round(self._schedule[0].shrink, SCHEDULE[0].steps, 0.0))
        self._device, self._levels = device, {}
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

    def maps(
        self,
        sources: Sequence[Sequence[int]],
        done: Callable[[float], None] = lambda share: None,
    ) -> list[PlaneMap]:
        """Estimate a plane for every pixel of every view.

        Args:
            sources: for each view the indices of its source views, 1 to `MAX_PATCH_SOURCES`.
            done: called with the finished share of the work, in [0, 1], several times per view.

        Raises:
            ValueError: a view has too few or too many sources.
        """
        for index, others in enumerate(sources):
            if not 1 <= len(others) <= MAX_PATCH_SOURCES:
                raise ValueError(
                    f"view {index} has {len(others)} source views; 1 to {MAX_PATCH_SOURCES} are allowed"
                )
        level, finished = self._start(sources), 0.0
        work = len(sources) * sum(r.work for r in self._schedule)
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
                self._device.finish()
                finished += stage.work
                done(finished / work)
        return [_plane_map(p.read(), c) for p, c in zip(level.planes, level.cameras, strict=True)]

    def _start(self, sources: Sequence[Sequence[int]]) -> PatchLevel:
        """The coarsest level with random planes; their cost is the mean of the two best views."""
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
    """Reduce an image to the camera's size by area averaging."""
    size = (camera.height, camera.width)
    return torch.nn.functional.adaptive_avg_pool2d(image[None, None].double(), size)[0, 0].float()


def _upsampled(planes: Tensor, camera: Camera) -> Tensor:
    """Planes `[4, H, W]` for a larger image of the same view, from the pixel that covers each one."""
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
