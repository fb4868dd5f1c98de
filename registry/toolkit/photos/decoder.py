"""Decode photographs from untrusted files: composite them on a background, resize them, cache the result.

Pillow supports about forty formats and chooses by content; for EPS it starts another program. Only the
formats that loaders support are tried, whatever the suffix.

A decoded photograph is 8-bit RGB, and resizing keeps it so, as in the published protocols. The disk cache
holds resized photographs, losslessly: decoding 16 megapixels takes about thirty times as long as reading
the small result.

    STEREOGS_CACHE/photographs/<key>/image.png    key: hash of the file, the treatment, Pillow's version
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, TypeAlias

from ...errors import SceneError
from ..cache import Cache, content_key
from .reading import decoding

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray
    from PIL import Image

Pixels: TypeAlias = "NDArray[np.uint8]"
"""`[H, W, 3]`, or `[H, W]` for one channel."""
Size = tuple[int, int]
"""`(width, height)` in pixels, as in Pillow, OpenCV and COLMAP; shapes of tensors are (height, width)."""
SizeRule = Callable[[int, int], Size]
"""Function of the stored width and height that returns the size to resize to."""
ResizeFilter = Literal["box", "bilinear", "bicubic", "lanczos"]
"""Names of Pillow's filters; each averages over the area when it downsamples."""
BACKGROUNDS = {"white": (1.0, 1.0, 1.0), "black": (0.0, 0.0, 0.0)}
"""Background colors for transparent pixels, in [0, 1], by name."""

FORMATS = ("PNG", "JPEG", "WEBP", "TIFF", "BMP")
"""Pillow's names of the supported formats besides HEIF."""
_HEIF_BRANDS = (b"heic", b"heix", b"heim", b"heis", b"hevc", b"mif1", b"msf1")
MAX_PIXELS = 1 << 27
"""134 megapixels; a decoded pixel takes up to four bytes."""
UNCHECKED_PIXELS = 1 << 24
"""17 megapixels; images up to this size may have any compression ratio."""
PIXELS_PER_BYTE = 32
"""Pixels per byte of a larger file, at most; strongly compressed JPEGs have 16."""
IMAGE_FIX = "restore the photograph, or save it again as an 8-bit PNG or JPEG"
HEIF_SUFFIXES = (".heic", ".heif")
"""Suffixes of HEIC files, the format of phones, in lower case; see `read_heif`."""
_ORIENTATION = 0x0112
QUARTER_TURNS = (5, 6, 7, 8)
"""Values of this EXIF tag that exchange width and height."""
EIGHT_BIT_MODES = ("1", "L", "LA", "P", "PA", "RGB", "RGBA", "CMYK", "YCbCr")
_CACHED = "image.png"


@contextmanager
def open_image(path: Path, what: str = "the image", fix: str = IMAGE_FIX) -> Iterator[Image.Image]:
    """Open an image file without decoding it; convert exceptions of the block as `decoding` does.

    Args:
        what, fix: Name of the image, and advice, for error messages.

    Raises:
        SceneError: The file is missing, not a regular file, or not a PNG, JPEG, WebP, TIFF, BMP or HEIC; a
            PNG has wrong checksums; the strips of a TIFF do not cover the image; the image has more
            than 134 megapixels, or more than 17 with over 32 pixels per byte; or the block raised.
    """
    from PIL import Image

    if not path.is_file():
        raise SceneError(f"{what} is missing, or not a regular file", where=str(path), fix=fix)
    # Damaged EXIF data count as missing. Not `catch_warnings`, which is not safe in threads.
    warnings.filterwarnings("ignore", module=r"PIL\.")
    with decoding(what, path, fix):
        formats = (*FORMATS, "HEIF") if _is_heif(path, what) else FORMATS
        with Image.open(path, formats=formats) as file:
            _check_size(file, path, what)
            file.verify()  # checks PNG's checksums, which decoding ignores
        with Image.open(path, formats=formats) as file:
            _check_coverage(file, path, what)
            yield file


def _check_size(file: Image.Image, path: Path, what: str) -> None:
    width, height = file.size
    pixels, size = width * height, path.stat().st_size
    if pixels > MAX_PIXELS:
        raise SceneError(
            f"{what} has {width}x{height} pixels, more than {MAX_PIXELS // 1_000_000} megapixels",
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


def _is_heif(path: Path, what: str) -> bool:
    """Return whether a file holds a HEIC picture, whatever its suffix; refuse it without a decoder."""
    with path.open("rb") as file:
        start = file.read(12)
    if start[4:8] != b"ftyp" or start[8:] not in _HEIF_BRANDS:
        return False
    if not read_heif():
        fix = "pip install 'stereogs-plugins[heic]', or convert it to JPEG"
        raise SceneError(f"{what} is in the format HEIC", where=str(path), fix=fix)
    return True


def read_heif() -> bool:
    """Register the HEIC decoder of pillow-heif with Pillow; return False if it is not installed."""
    try:
        import pillow_heif
    except ImportError:
        return False
    pillow_heif.register_heif_opener()
    return True


def divided_by(divisor: int, largest: int | None = None) -> SizeRule:
    """Divide each side and round it, as the published protocols do; then limit the longer side."""
    limited = longest_side(largest or MAX_PIXELS)
    return lambda width, height: limited(
        max(1, round(width / divisor)), max(1, round(height / divisor))
    )


def at_most(largest: int) -> SizeRule:
    """Limit the width to `largest` pixels, keep the proportions, never enlarge."""

    def size(width: int, height: int) -> Size:
        if width <= largest:
            return width, height
        return largest, max(1, round(height * largest / width))

    return size


def longest_side(largest: int) -> SizeRule:
    """Limit the longer side to `largest` pixels, keep the proportions, never enlarge."""

    def size(width: int, height: int) -> Size:
        scale = min(1.0, largest / max(width, height))
        return max(1, round(width * scale)), max(1, round(height * scale))

    return size


@dataclass(frozen=True)
class Decoder:
    """A reader of photographs.

    Args:
        size: Rule for the size; the default keeps the stored size.
        resize_filter: Pillow's filter for resizing.
        background: Color in [0, 1] behind transparent pixels.
        upright: If True, rotate photographs by their EXIF orientation. Camera files of data sets
            refer to pixels as stored.
    """

    size: SizeRule = lambda width, height: (width, height)
    resize_filter: ResizeFilter = "bicubic"
    background: tuple[float, float, float] = BACKGROUNDS["black"]
    upright: bool = False

    def read(self, path: Path) -> Pixels:
        """Return the colors, `[H, W, 3]` uint8.

        Raises:
            SceneError: See `open_image`; also for more than 8 bits per channel.
        """
        with open_8_bit(path) as file:
            return self._decoded(file, path, self._opaque, str(self.background))

    def read_alpha(self, path: Path) -> Pixels | None:
        """Return the opacity, `[H, W]` uint8; None for an opaque photograph. Raises as `read`."""
        with open_8_bit(path) as file:
            if not file.has_transparency_data:
                return None
            return self._decoded(file, path, alpha_channel, "alpha")

    def _decoded(
        self,
        file: Image.Image,
        path: Path,
        select: Callable[[Image.Image], Image.Image],
        selection: str,
    ) -> Pixels:
        """Apply `select`, then resize; `selection` holds its parameters for the key of the cache."""
        import numpy as np
        from PIL import Image, ImageOps

        stored = upright_size(file) if self.upright else file.size
        size = self.size(*stored)

        def selected() -> Image.Image:
            return select(ImageOps.exif_transpose(file) if self.upright else file)

        if size == stored:
            return np.asarray(selected())
        resample = Image.Resampling[self.resize_filter.upper()]
        treatment = f"{size} {self.resize_filter} {selection} {self.upright}"
        return np.asarray(_cached(path, treatment, lambda: selected().resize(size, resample)))

    def _opaque(self, file: Image.Image) -> Image.Image:
        from PIL import Image

        if not file.has_transparency_data:
            return file.convert("RGB")
        color = tuple(round(255 * channel) for channel in self.background)
        below = Image.new("RGBA", file.size, (*color, 255))
        below.alpha_composite(file.convert("RGBA"))
        return below.convert("RGB")


def alpha_channel(file: Image.Image) -> Image.Image:
    """Return the opacity of an image with transparency, mode "L"."""
    return file.convert("RGBA").getchannel("A")


def _cached(path: Path, treatment: str, compute: Callable[[], Image.Image]) -> Image.Image:
    """Return `compute()`, from the cache if the same file was treated in the same way before."""
    import PIL
    from PIL import Image

    def read(folder: Path) -> Image.Image:
        with Image.open(folder / _CACHED, formats=("PNG",)) as file:
            return file.copy()

    cache = Cache("photographs")
    if cache.folder is None:
        return compute()
    key = content_key(path.read_bytes(), treatment, PIL.__version__)
    image = cache.load(key, read)
    if image is None:
        image = compute()
        cache.save(key, lambda folder: image.save(folder / _CACHED, compress_level=1))
    return image


@contextmanager
def open_8_bit(path: Path, what: str = "the image") -> Iterator[Image.Image]:
    """Open an image file as `open_image` does; also refuse more than 8 bits per channel."""
    with open_image(path, what) as file:
        if file.mode not in EIGHT_BIT_MODES:
            raise SceneError(
                f"{what} has pixels of mode {file.mode!r}, not 8 bits per channel",
                where=str(path),
                fix=IMAGE_FIX,
            )
        yield file


def stored_size(path: Path, *, upright: bool = False) -> Size:
    """Return `(width, height)` of an image file, if `upright` as `upright_size`. Raises as `open_image`."""
    with open_image(path) as file:
        return upright_size(file) if upright else file.size


def stored_form(path: Path) -> tuple[Size, int]:
    """Return `stored_size` and `exif_orientation` of an image file. Raises as `open_image`."""
    with open_image(path) as file:
        return file.size, exif_orientation(file)


def exif_orientation(file: Image.Image) -> int:
    """Return the EXIF orientation, 1 to 8; 1 if it is missing or means nothing."""
    value = file.getexif().get(_ORIENTATION, 1)
    return value if value in range(1, 9) else 1


def turned_by(image: Image.Image, orientation: int) -> Image.Image:
    """Return an image turned by the given EXIF orientation; the one in its file is ignored."""
    from PIL import ImageOps

    image.getexif()[_ORIENTATION] = orientation
    return ImageOps.exif_transpose(image)


def upright_size(file: Image.Image) -> Size:
    """Return `(width, height)` of a photograph after rotation by its EXIF orientation."""
    width, height = file.size
    turned = exif_orientation(file) in QUARTER_TURNS
    return (height, width) if turned else (width, height)
