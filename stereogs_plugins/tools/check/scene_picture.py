"""A picture of what a loader found: thumbnails of all views, and the cameras from above."""

from __future__ import annotations

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor

from registry import Scene, View
from registry.toolkit.drawing import to_bytes

from .top_view import draw_top_view

TRAIN_COLOR = (224, 112, 16)
TEST_COLOR = (32, 96, 208)
WIDTH = 1000
"""Pixels of the whole picture."""
_COLUMNS = 5
_MARGIN, _FRAME, _LABEL = 8, 4, 18
_BACKGROUND, _TEXT = (255, 255, 255), (32, 32, 32)
_FONT_SIZE = 13
_PLAN_HEIGHT = 640


def scene_picture(scene: Scene) -> Tensor:
    """`[H, W, 3]` in [0, 1]: a contact sheet of the split, below it the top view of the cameras."""
    sheet = _contact_sheet(scene)
    plan = Image.new("RGB", (WIDTH, _PLAN_HEIGHT), _BACKGROUND)
    draw_top_view(plan, scene, TRAIN_COLOR, TEST_COLOR)
    whole = Image.new("RGB", (WIDTH, sheet.height + plan.height), _BACKGROUND)
    whole.paste(sheet, (0, 0))
    whole.paste(plan, (0, sheet.height))
    return torch.from_numpy(np.array(whole)).float() / 255


def _contact_sheet(scene: Scene) -> Image.Image:
    """Training views first, then test views; frames in the split's colours, names below."""
    cell = (WIDTH - _MARGIN) // _COLUMNS
    side = cell - _MARGIN - 2 * _FRAME
    views = [(view, TRAIN_COLOR) for view in scene.train]
    views += [(view, TEST_COLOR) for view in scene.test]
    thumbnails = [_thumbnail(view, side) for view, _ in views]
    row_height = max(image.height for image in thumbnails) + 2 * _FRAME + _LABEL + _MARGIN
    rows = -(-len(views) // _COLUMNS)
    sheet = Image.new("RGB", (WIDTH, _MARGIN + _LABEL + rows * row_height), _BACKGROUND)
    pen = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(_FONT_SIZE)
    title = f"{scene.name}:"
    pen.text((_MARGIN, _MARGIN / 2), title, _TEXT, font)
    x = _MARGIN + pen.textlength(title, font)
    for count, kind, color in (
        (len(scene.train), "training", TRAIN_COLOR),
        (len(scene.test), "test", TEST_COLOR),
    ):
        text = f"  {count} {kind} views"
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
    """At most `side` pixels on each side; pixels that metrics leave out are greyed."""
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
    """The name, or its end if it is too long."""
    if pen.textlength(name, font) <= width:
        return name
    while name and pen.textlength(f"...{name}", font) > width:
        name = name[1:]
    return f"...{name}"
