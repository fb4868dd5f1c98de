"""A contact sheet of runs: for each data set the first test view's truth beside every render of it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

from registry.comparing.comparison import FinishedRun
from registry.drawing.pictures import ViewPictures
from registry.runs.results import RENDERS
from registry.system.files import replacing

THUMBNAIL = (160, 120)
"""The box that each picture is made to fit into, pixels."""
GROUPS_A_ROW = 3
GAP, CAPTION = 10, 18
QUALITY = 85
MAX_BYTES = 400_000


def draw(groups: Sequence[tuple[str, Sequence[FinishedRun]]], path: Path) -> None:
    """Write the sheet as a JPEG of at most `MAX_BYTES`.

    Args:
        groups: a caption, and the runs that show the same test view; equally many in each.
    """
    thumbnails = [(caption, _thumbnails(runs)) for caption, runs in groups]
    cell_width = len(thumbnails[0][1]) * THUMBNAIL[0] + GAP
    cell_height = CAPTION + THUMBNAIL[1] + GAP
    columns = min(GROUPS_A_ROW, len(groups))
    rows = -(-len(groups) // columns)
    sheet = Image.new("RGB", (columns * cell_width + GAP, rows * cell_height + GAP), "white")
    canvas = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(13)
    for index, (caption, images) in enumerate(thumbnails):
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


def _thumbnails(runs: Sequence[FinishedRun]) -> list[Image.Image]:
    """The truth, then each run's render."""
    name = next(iter(runs[0].results["views"]["test"]))
    renders = []
    for run in runs:
        with Image.open(ViewPictures.of(name, run.folder / RENDERS).render) as picture:
            renders.append(picture.convert("RGB"))
    with Image.open(ViewPictures.of(name, runs[0].folder / RENDERS).comparison) as picture:
        # The truth comes first in a comparison, in the size of the render.
        truth = picture.convert("RGB").crop((0, 0, *renders[0].size))
    for image in (truth, *renders):
        image.thumbnail(THUMBNAIL, Image.Resampling.LANCZOS)
    return [truth, *renders]
