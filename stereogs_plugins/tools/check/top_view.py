"""The cameras of a scene from above, drawn with Pillow."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from registry import Scene, View

from .labels import Color, Label, draw_labels, write

Array = NDArray[np.float64]

_AXES, _TEXT = (200, 200, 200), (32, 32, 32)
_BORDER = 48
_FONT_SIZE = 12
_REACH = 0.07
"""Length of a drawn field of view, in units of the plan's size."""
_PERCENTILES = (2.0, 98.0)
"""Points beyond are drawn only if they happen to fit."""
_LARGEST_DRAWN = 20000
_OUTLINE = 12
"""Pixels along each edge of a drawn field of view that no name covers."""
_ROOM = 3.0
"""Far points are held as far as so many times the cameras' own spread."""
_TICK_COUNT = 6


@dataclass(frozen=True)
class Plan:
    """The plane seen from above: two unit axes in the world and the map to pixels.

    Args:
        right, forward: `[3]` world directions; forward points up in the picture.
        center: `[2]` what is drawn in the middle, in plan coordinates.
        scale: pixels for each world unit.
        size: `(width, height)` of the picture.
    """

    right: Array
    forward: Array
    center: Array
    scale: float
    size: tuple[int, int]

    def coordinates(self, positions: Array) -> Array:
        """`[N, 2]` plan coordinates (right, forward) of `[N, 3]` world positions."""
        return positions @ np.stack([self.right, self.forward], axis=1)

    def pixels(self, coordinates: Array) -> Array:
        """`[N, 2]` pixels (column, row) of plan coordinates."""
        offset = (coordinates - self.center) * self.scale * [1.0, -1.0]
        return np.asarray(offset + np.array(self.size) / 2)


def draw_top_view(picture: Image.Image, scene: Scene, train: Color, test: Color) -> None:
    """Draw into a picture: points, a triangle for each camera's field of view, axes in world units.

    Up is the mean of the cameras' up directions; the mean viewing direction of the training views
    points up in the picture.
    """
    pen = ImageDraw.Draw(picture)
    plan = make_plan(scene, picture.size)
    numbers = _draw_axes(pen, plan)
    _draw_points(picture, plan, scene)
    reach = _REACH * min(picture.size) / plan.scale
    labels, drawn = [], [place for number in numbers for place in _along(number)]
    for views, color in ((scene.train, train), (scene.test, test)):
        for view in views:
            outline = _draw_camera(pen, plan, view, reach, color)
            labels.append(Label(outline[0], view.name, color))
            drawn += outline
    left_out = draw_labels(pen, labels, drawn, picture.size, _FONT_SIZE)
    if left_out:
        numbers.append(((_BORDER, 4 + _FONT_SIZE), f"there is no room for {left_out} more names"))
    for place, text in numbers:
        write(pen, place, text, _TEXT, _FONT_SIZE)


def make_plan(scene: Scene, size: tuple[int, int]) -> Plan:
    """A plan that holds all cameras, the nearer half of the points, and of the others those that leave
    the cameras room.
    """
    right, forward = _ground(scene)
    views = (*scene.train, *scene.test)
    content = np.stack([view.camera.center.numpy() for view in views])
    if scene.points is not None and len(scene.points):
        near = _near_points(scene.points.positions.double().numpy(), content)
        content = np.concatenate([content, near])
    else:
        far = [_seen_at(view, scene.bounds[0]) for view in scene.train]
        content = np.concatenate([content, np.stack(far)])
    flat = content @ np.stack([right, forward], axis=1)
    low, high = flat.min(axis=0), flat.max(axis=0)
    room = np.array(size) - 2 * _BORDER
    scale = float((room / np.maximum(high - low, 1e-9 * scene.bounds[1])).min())
    return Plan(right, forward, (low + high) / 2, scale, size)


def _near_points(positions: Array, centers: Array) -> Array:
    """Those `[M, 3]` of the points that the plan makes room for."""
    low, high = np.percentile(positions, _PERCENTILES, axis=0)
    kept = positions[((positions >= low) & (positions <= high)).all(axis=1)]
    spread = float(np.ptp(centers, axis=0).max())
    distance = np.linalg.norm(kept - centers.mean(axis=0), axis=1)
    limit = max(_ROOM * spread, float(np.median(distance))) if len(kept) else 0.0
    return np.asarray(kept[distance <= limit])


def _seen_at(view: View, depth: float) -> Array:
    """The point on the optical axis at a depth."""
    pose = view.camera.world_to_camera.numpy()
    return np.asarray(view.camera.center.numpy() + depth * pose[2, :3])


def _ground(scene: Scene) -> tuple[Array, Array]:
    """Unit vectors right and forward of the ground plane, whose normal is the mean up direction."""
    poses = np.stack([view.camera.world_to_camera.numpy() for view in scene.train])
    up = -poses[:, 1, :3].mean(axis=0)
    if np.linalg.norm(up) < 1e-6:  # cameras rolled against each other
        up = -poses[0, 1, :3]
    up = up / np.linalg.norm(up)
    # Cameras in a ring look nowhere on average, ones from above look along `up`: then take what is left.
    for direction in (poses[:, 2, :3].mean(axis=0), poses[0, 2, :3], *np.eye(3)):
        forward = direction - up * (direction @ up)
        if np.linalg.norm(forward) > 0.1:
            break
    forward = forward / np.linalg.norm(forward)
    return np.cross(forward, up), forward


Text = tuple[tuple[float, float], str]
"""Its left upper corner, in pixels, and what it says."""


def _along(text: Text) -> list[tuple[float, float]]:
    """Pixels of a text that no name may cover."""
    (left, top), letters = text
    step = _FONT_SIZE / 2
    return [(left + step * k, top + step) for k in range(len(letters) + 1)]


def _draw_axes(pen: ImageDraw.ImageDraw, plan: Plan) -> list[Text]:
    """Grid lines at round world coordinates; returns what is to be written below and to the left."""
    texts: list[Text] = [((_BORDER, 2), "from above; axes right and forward, world units")]
    half = np.array(plan.size) / 2 / plan.scale
    low, high = plan.center - half, plan.center + half
    step = round_step(float((high - low).max()) / _TICK_COUNT)
    for value in _ticks(low[0], high[0], step):
        column = plan.pixels(np.array([[value, plan.center[1]]]))[0, 0]
        pen.line((column, 0, column, plan.size[1]), _AXES)
        texts.append(((column + 2, plan.size[1] - _FONT_SIZE - 4), f"{value:g}"))
    for value in _ticks(low[1], high[1], step):
        row = plan.pixels(np.array([[plan.center[0], value]]))[0, 1]
        pen.line((0, row, plan.size[0], row), _AXES)
        texts.append(((2, row + 1), f"{value:g}"))
    return texts


def round_step(wanted: float) -> float:
    """The smallest of 1, 2 or 5 times a power of ten that is at least `wanted`."""
    power = 10.0 ** math.floor(math.log10(wanted))
    return next(m * power for m in (1.0, 2.0, 5.0, 10.0) if m * power >= wanted)


def _ticks(low: float, high: float, step: float) -> Sequence[float]:
    return [k * step for k in range(math.ceil(low / step), math.floor(high / step) + 1)]


def _draw_points(picture: Image.Image, plan: Plan, scene: Scene) -> None:
    """One pixel each, in its colour, a little darkened so that white ones show."""
    if scene.points is None:
        return
    every = max(1, len(scene.points) // _LARGEST_DRAWN)
    positions = scene.points.positions[::every].double().numpy()
    colors = (204 * scene.points.colors[::every].numpy()).astype(np.uint8)
    cells = np.floor(plan.pixels(plan.coordinates(positions))).astype(int)
    inside = ((cells >= 0) & (cells < np.array(plan.size) - 1)).all(axis=1)
    pixels = np.array(picture)
    for column, row in ((0, 0), (1, 0), (0, 1), (1, 1)):
        pixels[cells[inside, 1] + row, cells[inside, 0] + column] = colors[inside]
    picture.paste(Image.fromarray(pixels))


def _draw_camera(
    pen: ImageDraw.ImageDraw, plan: Plan, view: View, reach: float, color: Color
) -> list[tuple[float, float]]:
    """A triangle from the camera's centre to the left and right ends of its middle row.

    Returns:
        Pixels along it, the centre's first.
    """
    camera = view.camera
    rotation = camera.world_to_camera[:3, :3].numpy()
    ends = np.array([[(u - camera.cx) / camera.fx, 0.0, 1.0] for u in (0.0, float(camera.width))])
    center = camera.center.numpy()
    corners = np.stack([center, *(center + reach * (ends @ rotation))])
    corner_pixels = plan.pixels(plan.coordinates(corners))
    apex, left, right = ((float(x), float(y)) for x, y in corner_pixels)
    pen.line((apex, left, right, apex), color, width=2)
    shares = np.linspace(0, 1, _OUTLINE, endpoint=False)[:, None]
    edges = zip(corner_pixels, np.roll(corner_pixels, -1, axis=0), strict=True)
    along = np.concatenate([start + shares * (end - start) for start, end in edges])
    return [(float(x), float(y)) for x, y in along]
