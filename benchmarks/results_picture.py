"""A contact sheet: for each data set the first test view, next to the render of each method."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

from benchmarks.results_page import Record, Records, by_case
from benchmarks.training_process import RENDERS
from benchmarks.trainings import Method
from registry.system.files import replacing
from registry.toolkit.drawing import ViewPictures

PICTURE = "results.jpg"
THUMBNAIL = (160, 120)
"""Largest size of a picture, pixels."""
GROUPS_A_ROW = 3
GAP, CAPTION = 10, 18
QUALITY = 85
MAX_BYTES = 400_000


def draw_first_views(records: Records, out: Path) -> None:
    """Write a sheet of the first test view of each data set, of the first seed with pictures.

    Args:
        records: Records; runs whose pictures are on another machine are skipped.
        out: Folder of the runs' folders; the sheet, a JPEG of at most `MAX_BYTES`, is written there.
    """
    groups = []
    for row in by_case(records):
        first: dict[Method, Record] = {}
        for record in row:
            if (out / record.run.name / RENDERS).is_dir():
                first.setdefault(record.run.method, record)
        if first:
            case = row[0].run.case
            thumbnails = _thumbnails(list(first.values()), out)
            groups.append((f"{case.data}, {case.views} views", thumbnails))
    if groups:
        _draw(groups, out / PICTURE)


def _draw(groups: Sequence[tuple[str, Sequence[Image.Image]]], path: Path) -> None:
    cell_width = max(len(images) for _, images in groups) * THUMBNAIL[0] + GAP
    cell_height = CAPTION + THUMBNAIL[1] + GAP
    columns = min(GROUPS_A_ROW, len(groups))
    rows = -(-len(groups) // columns)
    sheet = Image.new("RGB", (columns * cell_width + GAP, rows * cell_height + GAP), "white")
    canvas = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(13)
    for index, (caption, images) in enumerate(groups):
        left = GAP + index % columns * cell_width
        top = GAP + index // columns * cell_height
        canvas.text((left, top), caption, fill="black", font=font)
        for number, image in enumerate(images):
            sheet.paste(image, (left + number * THUMBNAIL[0], top + CAPTION))
    with replacing(path) as temporary:
        for quality in range(QUALITY, 0, -5):
            sheet.save(temporary, format="JPEG", quality=quality)
            if temporary.stat().st_size <= MAX_BYTES:
                break


def _thumbnails(records: Records, out: Path) -> list[Image.Image]:
    """The photograph, then the render of each run."""
    name = next(iter(records[0].measured["views"]))
    folders = [out / record.run.name / RENDERS for record in records]
    renders = []
    for folder in folders:
        with Image.open(ViewPictures.of(name, folder).render) as picture:
            renders.append(picture.convert("RGB"))
    with Image.open(ViewPictures.of(name, folders[0]).comparison) as picture:
        # A comparison starts with the photograph, in the size of the render.
        truth = picture.convert("RGB").crop((0, 0, *renders[0].size))
    for image in (truth, *renders):
        image.thumbnail(THUMBNAIL, Image.Resampling.LANCZOS)
    return [truth, *renders]
