"""The furniture of the `procedural` scene and its textures.

World units are metres; +x right, +y down, +z away from the cameras, which are near the origin.
"""

from __future__ import annotations

from importlib.resources import as_file, files
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image

from .ray_casting import Rectangle, Sphere, Surface, Texture

if TYPE_CHECKING:
    from numpy.typing import NDArray

LEFT, RIGHT = -2.4, 2.4
CEILING, FLOOR = -1.3, 1.15
FRONT, BACK = -1.5, 4.6

TYPICAL_DEPTH = 3.5
"""Depth at which a texel spans half a pixel: sharp without aliasing."""

POSTERS = ("astronaut.png", "chelsea.png", "rocket.jpg", "coffee.png")
PLACES, YAWS = ((-1.15, 2.9), (1.2, 3.2), (0.1, 2.35), (-0.1, 3.7)), (0.5, -0.45, 0.25, 0.3)
"""Mean (x, z) and rotation of the three boxes and the screen, metres and radians."""
WARM, COOL, CREAM = (1.0, 0.86, 0.72), (0.78, 0.88, 1.0), (1.0, 0.97, 0.9)


class Photographs:
    """Textures from the photographs in scikit-image, resized to the cameras' resolution.

    Args:
        texel: side of a texel on a surface, world units.
    """

    def __init__(self, texel: float) -> None:
        self._texel = texel

    def lay(
        self,
        name: str,
        width: float,
        height: float,
        *,
        tile: float = 0.0,
        tint: tuple[float, float, float] = (1.0, 1.0, 1.0),
        gain: float = 1.0,
        contrast: float = 1.0,
    ) -> Texture:
        """Texture for a surface of `width` x `height`.

        Args:
            name: file name in the folder `skimage.data`.
            tile: width of one copy if the photograph repeats; 0 stretches one copy over the surface.
            tint: factor per colour channel.
            gain: brightness factor.
            contrast: values below 1 mix the photograph with its mean colour.
        """
        with as_file(files("skimage.data") / name) as path, Image.open(path) as file:
            picture = file.convert("RGB")
        tile_width = tile or width
        tile_height = tile * picture.height / picture.width or height
        size = (self._texels(tile_width), self._texels(tile_height))
        pixels = np.asarray(picture.resize(size, Image.Resampling.LANCZOS), dtype=np.float64) / 255
        mean = pixels.mean(axis=(0, 1))
        pixels = mean + contrast * (pixels - mean)
        return Texture(
            np.clip(pixels * gain * np.array(tint), 0, 1), width / tile_width, height / tile_height
        )

    def _texels(self, length: float) -> int:
        return max(2, round(length / self._texel))


def furnish(focal: float, generator: np.random.Generator) -> list[Surface]:
    """All surfaces of the room.

    Args:
        focal: focal length of the cameras, pixels.
        generator: shifts and rotates the furniture slightly and permutes the posters.
    """
    photographs = Photographs(texel=0.5 * TYPICAL_DEPTH / focal)
    posters = list(generator.permutation(POSTERS))
    jitter = generator.uniform(-1, 1, size=(4, 3))
    left, right, front, screen = (
        (x + 0.12 * float(j[0]), z + 0.12 * float(j[1]))
        for (x, z), j in zip(PLACES, jitter, strict=True)
    )
    yaw = [at + 0.2 * j for at, j in zip(YAWS, jitter[:, 2], strict=True)]
    return [
        *_walls(photographs),
        *_posters(photographs, posters[:3]),
        *_box(photographs, "motorcycle_left.png", center=left, size=(0.95, 0.85, 0.7), yaw=yaw[0]),
        *_box(photographs, "ihc.png", center=right, size=(0.7, 1.0, 0.7), yaw=yaw[1]),
        _ball(photographs, "retina.jpg", right, 0.34, FLOOR - 1.0),
        *_box(
            photographs, "coins.png", center=front, size=(0.6, 0.32, 0.45), yaw=yaw[2], tint=WARM
        ),
        _ball(photographs, "moon.png", front, 0.2, FLOOR - 0.32),
        _screen(photographs, posters[3], screen, yaw[3]),
    ]


def _walls(photographs: Photographs) -> list[Surface]:
    width, height, depth = RIGHT - LEFT, FLOOR - CEILING, BACK - FRONT
    lay = photographs.lay
    back = lay("grass.png", width, height, tile=3.6, tint=COOL, gain=1.5, contrast=0.6)
    floor = lay("gravel.png", width, depth, tile=2.2, tint=CREAM, gain=1.2)
    ceiling = lay("gravel.png", width, depth, tile=3.0, tint=CREAM, gain=1.7, contrast=0.3)
    brick = lay("brick.png", depth, height, tile=1.6, tint=WARM, gain=1.5)
    right, down, away = _vector(width, 0, 0), _vector(0, height, 0), _vector(0, 0, depth)
    return [
        Rectangle(_vector(LEFT, CEILING, BACK), right, down, back),
        Rectangle(_vector(LEFT, FLOOR, BACK), right, -away, floor),
        Rectangle(_vector(LEFT, CEILING, FRONT), right, away, ceiling),
        Rectangle(_vector(LEFT, CEILING, FRONT), away, down, brick),
        Rectangle(_vector(RIGHT, CEILING, BACK), -away, down, brick),
    ]


def _posters(photographs: Photographs, names: list[str]) -> list[Surface]:
    width, height, gap = 1.1, 0.95, 0.03
    across, down = _vector(width, 0, 0), _vector(0, height, 0)
    return [
        Rectangle(
            _vector(x - width / 2, -1.05, BACK - gap),
            across,
            down,
            photographs.lay(name, width, height),
        )
        for x, name in zip((-1.45, 0.0, 1.45), names, strict=True)
    ]


def _screen(
    photographs: Photographs, name: str, place: tuple[float, float], yaw: float
) -> Rectangle:
    """A freestanding picture."""
    width, height = 1.0, 0.7
    across = width * _vector(np.cos(yaw), 0, np.sin(yaw))
    corner = _vector(place[0], FLOOR - height, place[1]) - across / 2
    texture = photographs.lay(name, width, height, gain=1.1)
    return Rectangle(corner, across, _vector(0, height, 0), texture)


def _box(
    photographs: Photographs,
    name: str,
    *,
    center: tuple[float, float],
    size: tuple[float, float, float],
    yaw: float,
    tint: tuple[float, float, float] = (1.0, 1.0, 1.0),
) -> list[Surface]:
    """A box on the floor with the same photograph on its four sides and its top.

    Args:
        center: (x, z) of its centre.
        size: width, height, depth.
        yaw: rotation about the vertical axis, radians.
    """
    width, height, depth = size
    right = _vector(np.cos(yaw), 0, np.sin(yaw))
    away = _vector(-np.sin(yaw), 0, np.cos(yaw))
    top = _vector(center[0], FLOOR - height, center[1])
    down = _vector(0, height, 0)
    x, z = right * width / 2, away * depth / 2
    wide = photographs.lay(name, width, height, tint=tint)
    deep = photographs.lay(name, depth, height, tint=tint)
    lid = photographs.lay(name, width, depth, tint=tint)
    return [
        Rectangle(top - x - z, 2 * x, down, wide),
        Rectangle(top + x + z, -2 * x, down, wide),
        Rectangle(top + x - z, 2 * z, down, deep),
        Rectangle(top - x + z, -2 * z, down, deep),
        Rectangle(top - x + z, 2 * x, -2 * z, lid),
    ]


def _ball(
    photographs: Photographs, name: str, place: tuple[float, float], radius: float, floor: float
) -> Sphere:
    texture = photographs.lay(name, 2 * np.pi * radius, np.pi * radius, tile=np.pi * radius)
    return Sphere(_vector(place[0], floor - radius, place[1]), radius, texture)


def _vector(x: float, y: float, z: float) -> NDArray[np.float64]:
    return np.array([x, y, z], dtype=np.float64)
