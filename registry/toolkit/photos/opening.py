"""Open untrusted image files: check the format, the size, and that no data is missing.

Pillow supports about forty formats and chooses by content; for EPS it starts another program. Only the
formats that loaders support are tried, whatever the suffix.
"""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

from ...errors import SceneError
from .reading import decoding

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from PIL import Image

FORMATS = ("PNG", "JPEG", "WEBP", "TIFF", "BMP")
"""Pillow's names of the supported formats; `read_heif` adds HEIF."""
MOST_PIXELS = 1 << 27
"""134 megapixels; a decoded pixel takes up to four bytes."""
UNCHECKED_PIXELS = 1 << 24
"""17 megapixels; images up to this size may have any compression ratio."""
PIXELS_PER_BYTE = 32
"""Pixels per byte of a larger file, at most; strongly compressed JPEGs have 16."""
IMAGE_FIX = "restore the photograph, or save it again as an 8-bit PNG or JPEG"


@contextmanager
def open_image(path: Path, what: str = "the image", fix: str = IMAGE_FIX) -> Iterator[Image.Image]:
    """Open an image file without decoding it; convert exceptions of the block as `decoding` does.

    Args:
        what: Name of the image for error messages.
        fix: Advice for a file that cannot be read.

    Raises:
        SceneError: The file is missing, not a regular file, or not a PNG, JPEG, WebP, TIFF or BMP; a
            PNG has wrong checksums; the strips of a TIFF do not cover the image; the image has more
            than 134 megapixels, or more than 17 with over 32 pixels per byte; or the block raised.
    """
    from PIL import Image

    formats = (*FORMATS, "HEIF") if "HEIF" in Image.OPEN else FORMATS
    if not path.is_file():
        raise SceneError(f"{what} is missing, or not a regular file", where=str(path), fix=fix)
    with decoding(what, path, fix):
        with Image.open(path, formats=formats) as file:
            _check_size(file, path, what)
            file.verify()  # checks PNG's checksums, which decoding ignores
        with Image.open(path, formats=formats) as file:
            _check_coverage(file, path, what)
            yield file


def _check_size(file: Image.Image, path: Path, what: str) -> None:
    width, height = file.size
    pixels, size = width * height, path.stat().st_size
    if pixels > MOST_PIXELS:
        raise SceneError(
            f"{what} has {width}x{height} pixels, more than {MOST_PIXELS // 1_000_000} megapixels",
            where=str(path),
            fix="downsample it; training uses a much smaller size",
        )
    if pixels > max(UNCHECKED_PIXELS, size * PIXELS_PER_BYTE):
        raise SceneError(
            f"{what} has {width}x{height} pixels in a file of {size:,} bytes, which no photograph has",
            where=str(path),
            fix="remove it; if it is a photograph, save it again with less compression",
        )


def _check_coverage(file: Image.Image, path: Path, what: str) -> None:
    """Refuse a TIFF whose strips do not cover the image; Pillow would fill the rest with black."""
    places = {tile[1] for tile in getattr(file, "tile", ())}
    covered = sum((right - left) * (low - top) for left, top, right, low in filter(None, places))
    width, height = file.size
    if places and covered < width * height:
        raise SceneError(
            f"{what} has {width}x{height} pixels, but holds {covered:,} of them",
            where=str(path),
            fix=IMAGE_FIX,
        )
