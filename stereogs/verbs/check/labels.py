"""Write labels near points of an image without overlaps."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from PIL import ImageDraw, ImageFont

Color = tuple[int, int, int]
Box = tuple[float, float, float, float]

_DIRECTIONS = 16
_DISTANCES = (6.0, 14.0, 26.0, 42.0, 62.0, 90.0, 130.0, 180.0)
"""Distances from the point to its label in pixels, tried in this order."""
_HALO = 2
"""Width of the white outline of letters in pixels."""
_LINE_FROM = 14.0
"""From this distance on, a line connects the point with its label."""


@dataclass(frozen=True)
class Label:
    """A label of a point; `place` is its column and row in pixels."""

    place: tuple[float, float]
    text: str
    color: Color


def draw_labels(
    pen: ImageDraw.ImageDraw,
    labels: Sequence[Label],
    kept_free: Sequence[tuple[float, float]],
    size: tuple[int, int],
    font_size: int,
) -> int:
    """Write each label as close to its point as possible; return how many had no room.

    Args:
        kept_free: pixels (column, row) that no label may cover.
        size: width and height of the image.
    """
    font = ImageFont.load_default(font_size)
    found: list[tuple[Label, Box]] = []
    taken: list[Box] = [(x - 2, y - 2, x + 2, y + 2) for x, y in kept_free]
    left_out = 0
    for label in labels:
        width, height = pen.textlength(label.text, font), font_size + 2.0
        free = (
            (distance, box)
            for distance, box in _candidates(label.place, width, height)
            if _inside(box, size) and not any(_overlap(box, other) for other in taken)
        )
        nearest = next(free, None)
        if nearest is None:
            left_out += 1
            continue
        distance, box = nearest
        taken.append(box)
        found.append((label, box))
        if distance >= _LINE_FROM:
            x, y = label.place
            nearest_point = (min(max(x, box[0]), box[2]), min(max(y, box[1]), box[3]))
            pen.line((label.place, nearest_point), label.color)
    for label, box in found:  # after all lines, so that no line crosses a label
        write(pen, box[:2], label.text, label.color, font_size)
    return left_out


def write(
    pen: ImageDraw.ImageDraw, place: tuple[float, float], text: str, color: Color, font_size: int
) -> None:
    """Write outlined text that is readable on any background; `place` is its upper left corner."""
    font = ImageFont.load_default(font_size)
    pen.text(place, text, color, font, stroke_width=_HALO, stroke_fill=(255, 255, 255))


def _candidates(
    place: tuple[float, float], width: float, height: float
) -> Iterator[tuple[float, Box]]:
    """Yield distances and boxes around a point, closest first, beginning at the lower right."""
    for distance, step in itertools.product(_DISTANCES, range(_DIRECTIONS)):
        angle = 2 * math.pi * (step / _DIRECTIONS + 1 / 16)
        across, down = math.cos(angle), math.sin(angle)
        left = place[0] + distance * across - width * (1 - across) / 2
        top = place[1] + distance * down - height * (1 - down) / 2
        yield distance, (left, top, left + width, top + height)


def _inside(box: Box, size: tuple[int, int]) -> bool:
    return box[0] >= 0 and box[1] >= 0 and box[2] <= size[0] and box[3] <= size[1]


def _overlap(one: Box, other: Box) -> bool:
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]
