"""Opening image files that nobody vouches for: which formats, how large, and whether they are whole.

Pillow knows some forty formats and chooses by content; for EPS it starts another program. Only the
formats that loaders promise are ever looked for, whatever the file is called.
"""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

from ....errors import SceneError
from ..reading import decoding

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from PIL import Image

FORMATS = ("PNG", "JPEG", "WEBP", "TIFF", "BMP")
"""Pillow's names of the formats that are read; HEIF too, where `read_heif` has let Pillow read it."""
MOST_PIXELS = 1 << 27
"""Of an image, 134 megapixels; decoded it takes up to four bytes a pixel."""
UNQUESTIONED_PIXELS = 1 << 24
"""Up to so many, 17 megapixels, a file may be as small as it likes."""
PIXELS_PER_BYTE = 32
"""A larger image with more pixels for each byte of its file is no photograph; strong JPEGs have 16."""
IMAGE_FIX = "restore the photograph, or save it anew as an 8-bit PNG or JPEG"


@contextmanager
def open_image(path: Path, what: str = "the image", fix: str = IMAGE_FIX) -> Iterator[Image.Image]:
    """An image file, open and not decoded; what its block raises is explained as by `decoding`.

    Args:
        what: it is, for error messages.
        fix: what to do about a file that cannot be read.

    Raises:
        SceneError: the file is missing, no regular file, of another format than PNG, JPEG, WebP, TIFF
            or BMP, a PNG whose checksums are wrong, a TIFF whose strips leave a part out, larger than
            134 megapixels, or larger than 17 with fewer than one byte for 32 pixels; or the block gave
            up on it.
    """
    from PIL import Image

    formats = (*FORMATS, "HEIF") if "HEIF" in Image.OPEN else FORMATS
    if not path.is_file():
        raise SceneError(f"{what} is missing, or no regular file", where=str(path), fix=fix)
    with decoding(what, path, fix):
        with Image.open(path, formats=formats) as file:
            _check_size(file, path, what)
            file.verify()  # of these formats, PNG alone has checksums; decoding does not look at them
        with Image.open(path, formats=formats) as file:
            _check_whole(file, path, what)
            yield file


def _check_size(file: Image.Image, path: Path, what: str) -> None:
    width, height = file.size
    pixels, size = width * height, path.stat().st_size
    said = f"{what} has {width}x{height} pixels"
    if pixels > MOST_PIXELS:
        raise SceneError(
            f"{said}, more than {MOST_PIXELS // 1_000_000} megapixels",
            where=str(path),
            fix="reduce it; training looks at a small part of that",
        )
    if pixels > max(UNQUESTIONED_PIXELS, size * PIXELS_PER_BYTE):
        raise SceneError(
            f"{said} in a file of {size:,} bytes, which no photograph has",
            where=str(path),
            fix="leave it out; if it is a photograph, save it anew with less compression",
        )


def _check_whole(file: Image.Image, path: Path, what: str) -> None:
    """Pillow fills with black what the strips of a TIFF leave out, however much that is."""
    places = {tile[1] for tile in getattr(file, "tile", ())}
    covered = sum((right - left) * (low - top) for left, top, right, low in filter(None, places))
    width, height = file.size
    if places and covered < width * height:
        raise SceneError(
            f"{what} has {width}x{height} pixels and holds {covered:,} of them",
            where=str(path),
            fix=IMAGE_FIX,
        )
