from __future__ import annotations

import numpy as np
from PIL import Image, ImageDraw

from stereogs.verbs.check.labels import Label, draw_labels, write

COLORS = ((255, 0, 0), (0, 0, 255))
SIZE = (200, 120)


def boxes(places: list[tuple[float, float]]) -> tuple[list[tuple[int, int, int, int]], int]:
    """Return the box of each label, found by its color, and the number of omitted labels."""
    picture = Image.new("RGB", SIZE, (255, 255, 255))
    labels = [Label(place, "a name", COLORS[k % 2]) for k, place in enumerate(places)]
    left_out = draw_labels(ImageDraw.Draw(picture), labels, places, SIZE, 12)
    pixels = np.array(picture).astype(int)
    found = []
    for color in COLORS[: len(places)]:
        other = COLORS[1 - COLORS.index(color)]
        near = (np.abs(pixels - color).sum(2) < np.abs(pixels - other).sum(2)) & (
            pixels.sum(2) < 600
        )
        rows, columns = np.nonzero(near)
        found.append((columns.min(), rows.min(), columns.max(), rows.max()))
    return found, left_out


def test_labels_of_close_points_do_not_overlap() -> None:
    (one, two), left_out = boxes([(100.0, 60.0), (101.0, 60.0)])
    assert left_out == 0
    assert one[2] < two[0] or two[2] < one[0] or one[3] < two[1] or two[3] < one[1]


def test_a_label_stays_in_the_image() -> None:
    ((left, top, right, bottom),), left_out = boxes([(199.0, 119.0)])
    assert left_out == 0
    assert right - left > 25, "all of it"
    assert bottom - top > 5


def test_labels_without_room_are_omitted_and_counted() -> None:
    picture = Image.new("RGB", (120, 60))
    labels = [Label((60.0, 30.0), "a name", (255, 255, 255)) for _ in range(20)]
    left_out = draw_labels(ImageDraw.Draw(picture), labels, [], (120, 60), 12)
    assert 5 < left_out < 20


def test_dark_text_is_readable_on_a_dark_background() -> None:
    picture = Image.new("RGB", (120, 40))
    write(ImageDraw.Draw(picture), (20, 10), "a name", (0, 0, 0), 12)
    bright = np.array(picture).mean(axis=2) > 200
    rows, columns = np.nonzero(bright)
    assert bright.sum() > 200
    assert (columns.min(), rows.min()) < (20, 14)
    assert not bright[rows.min() : rows.max(), columns.min() : columns.max()].all(), "the letters"
