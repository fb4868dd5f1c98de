"""A small ray caster: textured rectangles and spheres, exact depth, view-independent shading.

All rays of a view start at the camera centre o. Their directions d have z = 1 in the camera, so the
parameter t of a hit o + t d is its z-depth.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray

if TYPE_CHECKING:
    from collections.abc import Sequence

    from core_rasterizer import Camera

Array = NDArray[np.float64]

SAMPLES = 3
"""Rays per pixel along each axis; odd, so that one of them passes through the pixel's centre."""


@dataclass(frozen=True, eq=False)
class Texture:
    """A photograph with mirrored repetition, which avoids seams.

    Args:
        pixels: `[H, W, 3]` float64 in [0, 1].
        repeat_u, repeat_v: number of repetitions over a surface.
    """

    pixels: Array
    repeat_u: float = 1.0
    repeat_v: float = 1.0

    def sample(self, u: Array, v: Array) -> Array:
        """Colours `[P, 3]` at surface coordinates `u`, `v` in [0, 1], bilinear."""
        height, width = self.pixels.shape[:2]
        x0, x1, fraction_x = _texels(u * self.repeat_u, width)
        y0, y1, fraction_y = _texels(v * self.repeat_v, height)
        upper = _mix(self.pixels[y0, x0], self.pixels[y0, x1], fraction_x)
        lower = _mix(self.pixels[y1, x0], self.pixels[y1, x1], fraction_x)
        return _mix(upper, lower, fraction_y)


def _texels(position: Array, size: int) -> tuple[NDArray[np.intp], NDArray[np.intp], Array]:
    """The two texels next to a position, and the weight of the second one."""
    mirrored = 1 - np.abs(position % 2 - 1)
    texel = np.clip(mirrored * size - 0.5, 0, size - 1)
    first = texel.astype(np.intp)
    return first, np.minimum(first + 1, size - 1), texel - first


def _mix(first: Array, second: Array, weight: Array) -> Array:
    return first + weight[:, None] * (second - first)


LIGHT = np.array([-0.45, -0.75, -0.5]) / np.linalg.norm([-0.45, -0.75, -0.5])
"""Direction towards the light: left, above and behind the camera."""
AMBIENT = 0.6
"""Brightness of a surface that faces away from the light."""


@dataclass(frozen=True, eq=False)
class Rectangle:
    """A rectangle visible from the side where `across` points right and `down` down; invisible from behind.

    Args:
        corner: `[3]` upper left corner.
        across, down: `[3]` edges, world units.
        texture: texture of the front.
    """

    corner: Array
    across: Array
    down: Array
    texture: Texture

    @property
    def normal(self) -> Array:
        """`[3]` unit vector towards the visible side."""
        normal = np.cross(self.down, self.across)
        return np.asarray(normal / np.linalg.norm(normal))

    def hull(self) -> Array:
        """`[K, 3]` points whose convex hull contains the surface."""
        offsets = [0 * self.across, self.across, self.down, self.across + self.down]
        return np.asarray(self.corner + np.array(offsets))

    def hit(self, origin: Array, directions: Array) -> tuple[Array, Array, Array]:
        """Inverse depth (0 where missed), u and v in [0, 1], each `[H, W]`, for rays `[H, W, 3]`."""
        offset = self.corner - origin
        if offset @ self.normal >= 0:
            missed = np.zeros(directions.shape[:2])
            return missed, missed, missed
        # o + t d = corner + u across + v down, hence d = [across, down, offset] (u/t, v/t, 1/t).
        basis = np.stack([self.across, self.down, offset], axis=1)
        u_over_t, v_over_t, inverse = np.moveaxis(directions @ np.linalg.inv(basis).T, -1, 0)
        inside = (
            (inverse > 0)
            & (u_over_t >= 0)
            & (u_over_t <= inverse)
            & (v_over_t >= 0)
            & (v_over_t <= inverse)
        )
        inverse = np.where(inside, inverse, 0)
        depth = 1 / np.where(inside, inverse, 1)
        return inverse, u_over_t * depth, v_over_t * depth

    def shade(self, u: Array, v: Array) -> Array:
        """Brightness factors `[P]` at surface coordinates."""
        return np.full(u.shape, AMBIENT + (1 - AMBIENT) * max(0.0, float(self.normal @ LIGHT)))


@dataclass(frozen=True, eq=False)
class Sphere:
    """A sphere with its texture wrapped around the vertical axis.

    Args:
        center: `[3]`.
        radius: > 0.
        texture: u is the longitude, v runs from top to bottom.
    """

    center: Array
    radius: float
    texture: Texture

    def hull(self) -> Array:
        """See `Rectangle.hull`."""
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        return np.asarray(self.center + self.radius * signs)

    def hit(self, origin: Array, directions: Array) -> tuple[Array, Array, Array]:
        """See `Rectangle.hit`."""
        offset = origin - self.center
        a = np.einsum("hwk,hwk->hw", directions, directions)
        half_b = directions @ offset
        discriminant = half_b**2 - a * (offset @ offset - self.radius**2)
        depth = (-half_b - np.sqrt(np.maximum(discriminant, 0))) / a
        inside = (discriminant > 0) & (depth > 0)
        x, y, z = np.moveaxis((offset + depth[..., None] * directions) / self.radius, -1, 0)
        longitude = np.arctan2(x, -z) / (2 * np.pi) + 0.5
        latitude = np.arccos(np.clip(-y, -1, 1)) / np.pi
        return np.where(inside, 1 / np.where(inside, depth, 1), 0), longitude, latitude

    def shade(self, u: Array, v: Array) -> Array:
        """See `Rectangle.shade`."""
        longitude, latitude = (u - 0.5) * 2 * np.pi, v * np.pi
        level = np.sin(latitude)
        x, y, z = level * np.sin(longitude), -np.cos(latitude), -level * np.cos(longitude)
        facing = x * LIGHT[0] + y * LIGHT[1] + z * LIGHT[2]
        return np.asarray(AMBIENT + (1 - AMBIENT) * np.maximum(facing, 0))


Surface = Rectangle | Sphere


def cast(surfaces: Sequence[Surface], camera: Camera) -> tuple[Array, Array]:
    """Render the surfaces.

    Returns:
        colours `[H, W, 3]` in [0, 1], the mean of `SAMPLES`² rays per pixel, and the z-depth `[H, W]` of
        the ray through the pixel's centre; 0 where no surface is hit.
    """
    origin = camera.center.numpy()
    directions = _directions(camera)
    shape = directions.shape[:2]
    inverse, u, v = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    nearest = np.full(shape, -1)
    for index, surface in enumerate(surfaces):
        window = _window(surface.hull(), camera)
        found, found_u, found_v = surface.hit(origin, directions[window])
        closer = found > inverse[window]
        inverse[window][closer] = found[closer]
        u[window][closer] = found_u[closer]
        v[window][closer] = found_v[closer]
        nearest[window][closer] = index
    colors = np.zeros((*shape, 3))
    for index, surface in enumerate(surfaces):
        mine = nearest == index
        brightness = surface.shade(u[mine], v[mine])
        colors[mine] = surface.texture.sample(u[mine], v[mine]) * brightness[:, None]
    blocks = colors.reshape(camera.height, SAMPLES, camera.width, SAMPLES, 3)
    center = inverse[SAMPLES // 2 :: SAMPLES, SAMPLES // 2 :: SAMPLES]
    depth = np.where(center > 0, 1 / np.where(center > 0, center, 1), 0)
    return np.clip(blocks.mean(axis=(1, 3)), 0, 1), depth


def _directions(camera: Camera) -> Array:
    """World-space ray directions `[SAMPLES H, SAMPLES W, 3]` with z = 1 in the camera."""
    x = ((np.arange(camera.width * SAMPLES) + 0.5) / SAMPLES - camera.cx) / camera.fx
    y = ((np.arange(camera.height * SAMPLES) + 0.5) / SAMPLES - camera.cy) / camera.fy
    local = np.stack(np.broadcast_arrays(x[None, :], y[:, None], 1.0), axis=-1)
    return np.asarray(local @ camera.world_to_camera[:3, :3].numpy())


def _window(hull: Array, camera: Camera) -> tuple[slice, slice]:
    """Block of rays that may hit a hull; all rays if it reaches behind the camera."""
    u, v, z = (values.numpy() for values in camera.project(torch.from_numpy(hull)))
    if z.min() < 1e-3:
        return slice(None), slice(None)
    return _span(v, camera.height), _span(u, camera.width)


def _span(pixels: Array, size: int) -> slice:
    first = np.clip(np.floor(pixels.min()), 0, size)
    last = np.clip(np.ceil(pixels.max()), 0, size)
    return slice(SAMPLES * int(first), SAMPLES * int(last))
