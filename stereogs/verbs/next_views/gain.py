"""The expected gain of a photograph: how much of what the views of interest show it would confirm.

A photograph s confirms a surface point p for a view v by

    share(s, p, v) = CONFIRMED * visible(s, p) * exp(-(angle / ANGLE)^2)

with the angle at p between s and v: error grows with the angle to the nearest photograph ("Mind the Gap",
arXiv 2607.01556). Photographs S leave unknown

    unknown(p, v) = product over s in S of (1 - share(s, p, v)).

The expected gain of a camera is the decrease of the mean of `unknown` over all points and views, times the
square root of the camera's overlap: the share of what it sees that is photographed from a similar direction.
What a single photograph shows cannot be triangulated.

The form and the numbers were chosen on photographs left out of training (docs/next_photograph.md).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import torch
from torch.nn.functional import max_pool2d, normalize

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Camera, Rendering

ANGLE = 20.0
"""Degrees at which a photograph confirms a share of 1/e."""
CONFIRMED = 0.7
"""What one photograph confirms of a point for a view from the same direction."""
MATCHED_ANGLE = 75.0
"""Degrees between two photographs at which they still share 1/e of their matches."""
OVERLAP = 0.3
"""Least overlap of a photograph that probably connects to the others."""
DEPTH_TOLERANCE = 0.03
"""A point this much farther than the depth that a camera sees is hidden, as a share of the depth."""
MIN_ALPHA = 0.3
"""Pixels with less alpha show no surface."""
RENDERED_PIXELS = 3600
"""Pixels of the renders, which decide what is hidden."""
_MAX_POINTS, _MIN_SPACING = 24_000, 3
"""Points of all views together; pixels between two points of a view."""


class ExpectedGain:
    """The expected gains of candidates, and how they change when one is taken.

    Args:
        render: renders the trained scene.
        training: cameras of the photographs; at least one.
        candidates: cameras to choose from; at least one. They are the views of interest too.
    """

    def __init__(
        self,
        render: Callable[[Camera], Rendering],
        training: Sequence[Camera],
        candidates: Sequence[Camera],
    ) -> None:
        spacing = math.sqrt(RENDERED_PIXELS * len(candidates) / _MAX_POINTS)
        spacing = max(_MIN_SPACING, math.ceil(spacing))
        cameras = [small(camera) for camera in (*training, *candidates)]
        depths, points, weights = [], [], []
        for index, camera in enumerate(cameras):
            rendering = render(camera)
            alpha = rendering.alpha.double()
            depth = rendering.depth.double() / alpha.clamp(min=1e-6)
            depths.append(_farthest_seen(rendering))
            if index >= len(training):
                grid = slice(spacing // 2, None, spacing)
                u, v = (axis[grid, grid] for axis in camera.pixel_centers())
                points.append(camera.unproject(u, v, depth[grid, grid]).reshape(-1, 3))
                light = torch.where(alpha > MIN_ALPHA, alpha, 0.0)[grid, grid].flatten()
                weights.append(light / len(light) / len(candidates))
        shown = torch.cat(points)
        eyes = [c.center.expand(len(p), 3) for c, p in zip(candidates, points, strict=True)]
        towards = normalize(torch.cat(eyes) - shown, dim=1)
        self._weights = torch.cat(weights)
        seen = [_sees(c, depth, shown) for c, depth in zip(cameras, depths, strict=True)]
        shares = [
            sees * CONFIRMED * _falling_off(camera, shown, towards, ANGLE)
            for camera, sees in zip(cameras, seen, strict=True)
        ]
        count = len(training)
        self._shares = torch.stack(shares[count:])
        self._unknown = (1 - torch.stack(shares[:count])).prod(dim=0)
        matched = [
            sees * _falling_off(camera, shown, towards, MATCHED_ANGLE)
            for camera, sees in zip(cameras[:count], seen, strict=False)
        ]
        self._overlap = _own_share(
            torch.stack(matched).amax(dim=0), self._weights, [len(p) for p in points]
        )

    @property
    def unknown(self) -> float:
        """What the photographs leave unknown, from 0 to 1: the mean over views and pixels."""
        return float((self._weights * self._unknown).sum() / self._weights.sum().clamp(min=1e-12))

    @property
    def overlap(self) -> Tensor:
        """Share of what each candidate sees that photographs show, `[C]` in [0, 1]."""
        return self._overlap

    def gains(self) -> Tensor:
        """Return the expected gain of each candidate, `[C]` from 0 to 1."""
        total = self._weights.sum().clamp(min=1e-12)
        decrease = self._shares @ (self._weights * self._unknown) / total
        return decrease * self._overlap.sqrt()

    def take(self, candidate: int) -> None:
        """Count a candidate as photographed: the gains of the others become smaller."""
        self._unknown = self._unknown * (1 - self._shares[candidate])


def _farthest_seen(rendering: Rendering) -> Tensor:
    """Return the z-depth up to which surfaces are visible around each pixel, `[H, W]` float64."""
    depth = rendering.depth.double() / rendering.alpha.double().clamp(min=1e-6)
    largest: Tensor = max_pool2d(depth[None], 3, 1, 1)[0]
    return largest


def small(camera: Camera) -> Camera:
    """Return the camera at a size of about RENDERED_PIXELS."""
    scale = math.sqrt(RENDERED_PIXELS / (camera.width * camera.height))
    width, height = (max(2, round(scale * side)) for side in (camera.width, camera.height))
    return camera.resized(width, height)


def _sees(camera: Camera, depth: Tensor, points: Tensor) -> Tensor:
    """Return whether a camera sees each point unoccluded, `[M]` bool.

    Args:
        depth: `[H, W]` z-depth up to which a pixel's surfaces are visible, world units.
    """
    u, v, z = camera.project(points)
    inside = camera.contains(u, v, z)
    rows, columns = (torch.where(inside, axis, 0).long() for axis in (v, u))
    return inside & (z <= (1 + DEPTH_TOLERANCE) * depth[rows, columns])


def _falling_off(camera: Camera, points: Tensor, towards: Tensor, scale: float) -> Tensor:
    """Return exp(-(angle / scale)^2), `[M]`, of the angle at each point between a camera and a direction.

    Args:
        points, towards: `[M, 3]`; directions have unit length.
        scale: degrees.
    """
    cosines = (normalize(camera.center - points, dim=1) * towards).sum(dim=1)
    angles = torch.rad2deg(cosines.clamp(-1, 1).arccos())
    return torch.exp(-((angles / scale) ** 2))


def _own_share(seen: Tensor, weights: Tensor, counts: Sequence[int]) -> Tensor:
    """Return the share of each view's own points that was seen, by weight, `[C]`."""
    parts = zip((weights * seen).split(counts), weights.split(counts), strict=True)
    return torch.stack([part.sum() / whole.sum().clamp(min=1e-12) for part, whole in parts])
