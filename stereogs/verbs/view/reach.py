"""Keep a browser's camera near the photographs: elsewhere a scene of few of them shows holes and haze."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from core_rasterizer import Camera
from registry.toolkit.drawing import CAMERA_LIMITS

_PAIR_ANGLE, _PAIR_SHIFT = 60.0, 0.6
"""Two cameras count as neighbours up to this angle in degrees between their axes, and this distance of what
they look at, in units of their distance to it. What is between neighbours counts as photographed."""
_PARTS = 8
"""Parts of the arc between two neighbours."""
_STEPS = 24
"""Bisections of the way back to the nearest pose."""

Rows = NDArray[np.float64]


class _Poses(NamedTuple):
    """Poses at target + radius * out that look at target: `[P, 3]`, `[P, 3]` of length 1, and `[P]`."""

    target: Rows
    out: Rows
    radius: Rows

    def mixed(self, other: _Poses, share: Rows) -> _Poses:
        """Return poses between these (share 0) and others (share 1)."""
        out = (1 - share)[:, None] * self.out + share[:, None] * other.out
        return _Poses(
            (1 - share)[:, None] * self.target + share[:, None] * other.target,
            out / np.linalg.norm(out, axis=1, keepdims=True),
            (1 - share) * self.radius + share * other.radius,
        )


class Reach:
    """Where a camera may be: within `CAMERA_LIMITS` of the photographs, or between two of them.

    Args:
        cameras: of the photographs, at least one.
        distances: from each camera to what it looks at, > 0.
    """

    def __init__(self, cameras: Sequence[Camera], distances: Sequence[float]) -> None:
        eyes = np.stack([camera.center.double().numpy() for camera in cameras])
        axes = np.stack([camera.world_to_camera[2, :3].double().numpy() for camera in cameras])
        radius = np.asarray(distances, float)
        taken = _Poses(eyes + radius[:, None] * axes, -axes, radius)
        first, second = np.array([*combinations(range(len(cameras)), 2)], int).reshape(-1, 2).T
        a, b = (_Poses(*(rows[k] for rows in taken)) for k in (first, second))
        shift = np.linalg.norm(a.target - b.target, axis=1) / np.minimum(a.radius, b.radius)
        near = (_degrees(a.out, b.out) < _PAIR_ANGLE) & (shift < _PAIR_SHIFT)
        a, b = (_Poses(*(rows[near] for rows in poses)) for poses in (a, b))
        between = [a.mixed(b, np.full(len(a.radius), part / _PARTS)) for part in range(1, _PARTS)]
        self._poses = _Poses(*map(np.concatenate, zip(taken, *between, strict=True)))

    def limited(self, eye: Rows, target: Rows) -> tuple[Rows, Rows]:
        """Return the nearest allowed position and orbit point of a camera, each `[3]`.

        Beyond the limits, the camera moves toward the nearest pose as far as the limit.
        """
        excess = _excess(eye, target, self._poses)
        best = int(excess.argmin())
        if excess[best] <= 1:
            return eye, target
        nearest = _Poses(*(rows[best : best + 1] for rows in self._poses))
        offset = eye - target
        radius = float(np.linalg.norm(offset))
        here = _Poses(target[None], offset[None] / radius, np.array([radius]))
        outside, inside = 0.0, 1.0
        for _ in range(_STEPS):
            share = (outside + inside) / 2
            moved = here.mixed(nearest, np.array([share]))
            place = moved.target[0] + moved.radius[0] * moved.out[0]
            if _excess(place, moved.target[0], nearest)[0] <= 1:
                inside, eye, target = share, place, moved.target[0]
            else:
                outside = share
        return eye, target


def _excess(eye: Rows, target: Rows, poses: _Poses) -> Rows:
    """How far a camera is from each pose; more than 1 is beyond a limit."""
    offset = eye - poses.target
    zoom = np.linalg.norm(offset, axis=1).clip(1e-12) / poses.radius
    bound = np.where(zoom < 1, CAMERA_LIMITS["nearest"], CAMERA_LIMITS["farthest"])
    shift = np.linalg.norm(target - poses.target, axis=1) / poses.radius
    angle = _degrees(offset, poses.out)
    terms = angle / CAMERA_LIMITS["angle"], np.log(zoom) / np.log(bound)
    excess: Rows = np.maximum.reduce([*terms, shift / CAMERA_LIMITS["shift"]])
    return excess


def _degrees(a: Rows, b: Rows) -> Rows:
    """Angles between vectors `[P, 3]`; those of `b` have length 1."""
    cosine = (a * b).sum(axis=1) / np.linalg.norm(a, axis=1).clip(1e-12)
    angles: Rows = np.degrees(np.arccos(cosine.clip(-1, 1)))
    return angles
