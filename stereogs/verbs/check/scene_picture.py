"""An image of a scene: thumbnails of all views, and the cameras from above."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor

from registry import Scene, View
from registry.messages.suggestions import counted
from registry.toolkit.drawing import to_bytes, upwards
from registry.toolkit.drawing.axis_ticks import multiples, round_step

from .labels import Color, Label, draw_labels, write

Array = NDArray[np.float64]

TRAIN_COLOR = (224, 112, 16)
TEST_COLOR = (32, 96, 208)
WIDTH = 1000
"""Width of the whole image in pixels."""
_COLUMNS = 5
_MARGIN, _FRAME, _LABEL = 8, 4, 18
_BACKGROUND, _TEXT = (255, 255, 255), (32, 32, 32)
_SHEET_FONT_SIZE = 13
_PLAN_HEIGHT = 640

_AXES = (200, 200, 200)
_BORDER = 48
_FONT_SIZE = 12
_CAMERA_LENGTH = 0.07
"""Length of a drawn field of view, relative to the size of the image."""
_PERCENTILES = (2.0, 98.0)
"""Points outside do not extend the drawn area."""
_MAX_POINTS = 20000
_OUTLINE = 12
"""Points along each edge of a drawn field of view that no label covers."""
_FARTHEST = 3.0
"""Points farther away do not extend the drawn area, in units of the cameras' spread."""
_TICK_COUNT = 6


def scene_picture(scene: Scene) -> Tensor:
    """Return an image `[H, W, 3]` in [0, 1]: a contact sheet of the views above a top view of the cameras."""
    sheet = _contact_sheet(scene)
    plan = Image.new("RGB", (WIDTH, _PLAN_HEIGHT), _BACKGROUND)
    _draw_top_view(plan, scene)
    whole = Image.new("RGB", (WIDTH, sheet.height + plan.height), _BACKGROUND)
    whole.paste(sheet, (0, 0))
    whole.paste(plan, (0, sheet.height))
    return torch.from_numpy(np.array(whole)).float() / 255


def _contact_sheet(scene: Scene) -> Image.Image:
    """Draw training views, then test views, with frames in the color of the split and names below."""
    cell = (WIDTH - _MARGIN) // _COLUMNS
    side = cell - _MARGIN - 2 * _FRAME
    views = [(view, TRAIN_COLOR) for view in scene.train]
    views += [(view, TEST_COLOR) for view in scene.test]
    thumbnails = [_thumbnail(view, side) for view, _ in views]
    row_height = max(image.height for image in thumbnails) + 2 * _FRAME + _LABEL + _MARGIN
    rows = -(-len(views) // _COLUMNS)
    sheet = Image.new("RGB", (WIDTH, _MARGIN + _LABEL + rows * row_height), _BACKGROUND)
    pen = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(_SHEET_FONT_SIZE)
    x = float(_MARGIN)
    for text, color in (
        (f"{scene.name}:", _TEXT),
        (f"  {counted(len(scene.train), 'training view')}", TRAIN_COLOR),
        (f"  {counted(len(scene.test), 'test view')}", TEST_COLOR),
    ):
        pen.text((x, _MARGIN / 2), text, color, font)
        x += pen.textlength(text, font)
    for index, ((view, color), image) in enumerate(zip(views, thumbnails, strict=True)):
        left = _MARGIN + index % _COLUMNS * cell
        top = _MARGIN + _LABEL + index // _COLUMNS * row_height
        right, bottom = left + image.width + 2 * _FRAME, top + image.height + 2 * _FRAME
        pen.rectangle((left, top, right - 1, bottom - 1), color)
        sheet.paste(image, (left + _FRAME, top + _FRAME))
        pen.text((left, bottom + 1), _fitting(view.name, pen, font, side), color, font)
    return sheet


def _thumbnail(view: View, side: int) -> Image.Image:
    """Return a thumbnail of at most `side` pixels per side; masked pixels are grey."""
    image = view.image
    if view.mask is not None:
        image = torch.where(view.mask[..., None], image, 0.5 + 0.2 * (image - 0.5))
    picture = Image.fromarray(to_bytes(image))
    picture.thumbnail((side, side))
    return picture


def _fitting(
    name: str,
    pen: ImageDraw.ImageDraw,
    font: ImageFont.FreeTypeFont | ImageFont.ImageFont,
    width: int,
) -> str:
    """Return the name, or its end if it is too long."""
    if pen.textlength(name, font) <= width:
        return name
    while name and pen.textlength(f"...{name}", font) > width:
        name = name[1:]
    return f"...{name}"


@dataclass(frozen=True)
class Plan:
    """The map from the ground plane to pixels.

    Args:
        right, forward: `[3]` unit vectors in the world; forward points up in the image.
        center: `[2]` plan coordinates of the image center.
        scale: pixels per world unit.
        size: `(width, height)` of the image.
    """

    right: Array
    forward: Array
    center: Array
    scale: float
    size: tuple[int, int]

    def coordinates(self, positions: Array) -> Array:
        """Return plan coordinates `[N, 2]` (right, forward) of world positions `[N, 3]`."""
        return positions @ np.stack([self.right, self.forward], axis=1)

    def pixels(self, coordinates: Array) -> Array:
        """Return pixels `[N, 2]` (column, row) of plan coordinates `[N, 2]`."""
        offset = (coordinates - self.center) * self.scale * [1.0, -1.0]
        return np.asarray(offset + np.array(self.size) / 2)


def _draw_top_view(picture: Image.Image, scene: Scene) -> None:
    """Draw points, a triangle per camera, and axes in world units.

    The view is along the mean down direction of the training cameras; their mean viewing direction points up
    in the image.
    """
    pen = ImageDraw.Draw(picture)
    plan = make_plan(scene, picture.size)
    numbers = _draw_axes(pen, plan)
    _draw_points(picture, plan, scene)
    length = _CAMERA_LENGTH * min(picture.size) / plan.scale
    labels, drawn = [], [place for number in numbers for place in _along(number)]
    for views, color in ((scene.train, TRAIN_COLOR), (scene.test, TEST_COLOR)):
        for view in views:
            outline = _draw_camera(pen, plan, view, length, color)
            labels.append(Label(outline[0], view.name, color))
            drawn += outline
    left_out = draw_labels(pen, labels, drawn, picture.size, _FONT_SIZE)
    if left_out:
        numbers.append(((_BORDER, 4 + _FONT_SIZE), f"{left_out} more names have no room"))
    for place, text in numbers:
        write(pen, place, text, _TEXT, _FONT_SIZE)


def make_plan(scene: Scene, size: tuple[int, int]) -> Plan:
    """Return a plan with all cameras, the closer half of the points, and farther points up to a limit."""
    right, forward = _ground(scene)
    views = (*scene.train, *scene.test)
    content = np.stack([view.camera.center.numpy() for view in views])
    if scene.points is not None and len(scene.points):
        near = _near_points(scene.points.positions.double().numpy(), content)
        content = np.concatenate([content, near])
    else:
        axes = np.stack([view.camera.world_to_camera[2, :3].numpy() for view in scene.train])
        content = np.concatenate([content, content[: len(axes)] + scene.bounds[0] * axes])
    flat = content @ np.stack([right, forward], axis=1)
    low, high = flat.min(axis=0), flat.max(axis=0)
    room = np.array(size) - 2 * _BORDER
    scale = float((room / np.maximum(high - low, 1e-9 * scene.bounds[1])).min())
    return Plan(right, forward, (low + high) / 2, scale, size)


def _near_points(positions: Array, centers: Array) -> Array:
    """Return the points `[M, 3]` that must fit into the plan."""
    low, high = np.percentile(positions, _PERCENTILES, axis=0)
    kept = positions[((positions >= low) & (positions <= high)).all(axis=1)]
    spread = float(np.ptp(centers, axis=0).max())
    distance = np.linalg.norm(kept - centers.mean(axis=0), axis=1)
    limit = max(_FARTHEST * spread, float(np.median(distance))) if len(kept) else 0.0
    return np.asarray(kept[distance <= limit])


def _ground(scene: Scene) -> tuple[Array, Array]:
    """Return unit vectors right and forward of the ground plane; its normal is the mean up direction."""
    up = upwards([view.camera for view in scene.train])
    poses = np.stack([view.camera.world_to_camera.numpy() for view in scene.train])
    # The mean viewing direction is zero for cameras in a ring and along `up` for cameras above.
    for direction in (poses[:, 2, :3].mean(axis=0), poses[0, 2, :3], *np.eye(3)):
        forward = direction - up * (direction @ up)
        if np.linalg.norm(forward) > 0.1:
            break
    forward = forward / np.linalg.norm(forward)
    return np.cross(forward, up), forward


Text = tuple[tuple[float, float], str]
"""The upper left corner in pixels, and the text."""


def _along(text: Text) -> list[tuple[float, float]]:
    """Return pixels of a text that no label may cover."""
    (left, top), letters = text
    step = _FONT_SIZE / 2
    return [(left + step * k, top + step) for k in range(len(letters) + 1)]


def _draw_axes(pen: ImageDraw.ImageDraw, plan: Plan) -> list[Text]:
    """Draw grid lines at round world coordinates; return their numbers and a caption, to write later."""
    texts: list[Text] = [((_BORDER, 2), "from above; axes right and forward, world units")]
    half = np.array(plan.size) / 2 / plan.scale
    low, high = plan.center - half, plan.center + half
    step = round_step(float((high - low).max()) / _TICK_COUNT)
    for value in multiples(step, low[0], high[0]):
        column = plan.pixels(np.array([[value, plan.center[1]]]))[0, 0]
        pen.line((column, 0, column, plan.size[1]), _AXES)
        texts.append(((column + 2, plan.size[1] - _FONT_SIZE - 4), f"{value:g}"))
    for value in multiples(step, low[1], high[1]):
        row = plan.pixels(np.array([[plan.center[0], value]]))[0, 1]
        pen.line((0, row, plan.size[0], row), _AXES)
        texts.append(((2, row + 1), f"{value:g}"))
    return texts


def _draw_points(picture: Image.Image, plan: Plan, scene: Scene) -> None:
    """Draw each point as 2x2 pixels in its color, darkened so that white points are visible."""
    if scene.points is None:
        return
    every = max(1, len(scene.points) // _MAX_POINTS)
    positions = scene.points.positions[::every].double().numpy()
    colors = (204 * scene.points.colors[::every].numpy()).astype(np.uint8)
    cells = np.floor(plan.pixels(plan.coordinates(positions))).astype(int)
    inside = ((cells >= 0) & (cells < np.array(plan.size) - 1)).all(axis=1)
    pixels = np.array(picture)
    for column, row in ((0, 0), (1, 0), (0, 1), (1, 1)):
        pixels[cells[inside, 1] + row, cells[inside, 0] + column] = colors[inside]
    picture.paste(Image.fromarray(pixels))


def _draw_camera(
    pen: ImageDraw.ImageDraw, plan: Plan, view: View, length: float, color: Color
) -> list[tuple[float, float]]:
    """Draw a triangle from the camera center to both ends of the middle row; return pixels along it."""
    camera = view.camera
    rotation = camera.world_to_camera[:3, :3].numpy()
    ends = np.array([[(u - camera.cx) / camera.fx, 0.0, 1.0] for u in (0.0, float(camera.width))])
    center = camera.center.numpy()
    corners = np.stack([center, *(center + length * (ends @ rotation))])
    corner_pixels = plan.pixels(plan.coordinates(corners))
    apex, left, right = ((float(x), float(y)) for x, y in corner_pixels)
    pen.line((apex, left, right, apex), color, width=2)
    shares = np.linspace(0, 1, _OUTLINE, endpoint=False)[:, None]
    edges = zip(corner_pixels, np.roll(corner_pixels, -1, axis=0), strict=True)
    along = np.concatenate([start + shares * (end - start) for start, end in edges])
    return [(float(x), float(y)) for x, y in along]
