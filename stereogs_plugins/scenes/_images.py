"""Decoding photographs: in parallel, on one background, at one size.

A decoded photograph is 8-bit RGB until the end, as the published protocols resize it. Each thread
holds one photograph at full size (3 or 4 bytes a pixel) and its result; a view in memory takes 12
bytes a pixel of the training size. Resized photographs are kept on disk: decoding 16 megapixels anew
for every run costs some thirty times as much as reading the small result.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeAlias, TypeVar

from registry import SceneError

from ._reading import decoding
from ._resized_cache import remembered

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from PIL import Image

Pixels: TypeAlias = "NDArray[np.uint8]"
ResizeFilter = Literal["box", "bilinear", "bicubic", "lanczos"]
Size = tuple[int, int]

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".bmp")
_ORIENTATION = 0x0112
_QUARTER_TURNS = (5, 6, 7, 8)
"""Values of that EXIF tag that exchange width and height."""
BACKGROUNDS = {"white": (1.0, 1.0, 1.0), "black": (0.0, 0.0, 0.0)}
_MODES = ("1", "L", "LA", "P", "PA", "RGB", "RGBA", "CMYK", "YCbCr")
_FIX = "restore the photograph, or save it anew as an 8-bit PNG or JPEG"

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Decoder:
    """How photographs are read.

    Args:
        size: `(width, height)` wanted of a photograph that is stored as `(width, height)`.
        resize_filter: Pillow's filter of that name, which averages over the area when it reduces.
        background: colour, in [0, 1], that transparent pixels are laid on.
        upright: turn photographs as their EXIF orientation says. Camera files of data sets speak of
            pixels as they are stored.
    """

    size: Callable[[int, int], Size] = lambda width, height: (width, height)
    resize_filter: ResizeFilter = "bicubic"
    background: tuple[float, float, float] = BACKGROUNDS["black"]
    upright: bool = False

    def read(self, path: Path) -> Pixels:
        """`[H, W, 3]` uint8.

        Raises:
            SceneError: the file is missing, damaged, or has more than 8 bits a channel.
        """
        import numpy as np
        from PIL import Image

        with decoding("the image", path, _FIX), Image.open(path) as file:
            _check_mode(file, path)
            stored = upright_size(file) if self.upright else file.size
            size = self.size(*stored)
            if size == stored:
                return np.asarray(self._opaque(file))
            treatment = f"{size} {self.resize_filter} {self.background} {self.upright}"
            resample = Image.Resampling[self.resize_filter.upper()]
            image = remembered(path, treatment, lambda: self._opaque(file).resize(size, resample))
            return np.asarray(image)

    def _opaque(self, file: Image.Image) -> Image.Image:
        from PIL import Image, ImageOps

        if self.upright:
            file = ImageOps.exif_transpose(file)
        if not file.has_transparency_data:
            return file.convert("RGB")
        color = tuple(round(255 * channel) for channel in self.background)
        below = Image.new("RGBA", file.size, (*color, 255))
        below.alpha_composite(file.convert("RGBA"))
        return below.convert("RGB")


def read_mask(path: Path, size: Size) -> Pixels:
    """`[H, W]` uint8 brightness of a mask, resized with the bicubic filter if it has another size.

    Raises:
        SceneError: the file is missing or damaged.
    """
    import numpy as np
    from PIL import Image

    with decoding("the mask", path, _FIX), Image.open(path) as file:
        _check_mode(file, path)
        grey = file.convert("L")
        return np.asarray(
            grey if grey.size == size else grey.resize(size, Image.Resampling.BICUBIC)
        )


def stored_size(path: Path, *, upright: bool = False) -> Size:
    """`(width, height)` of an image file, turned as its EXIF orientation says if `upright`.

    Raises:
        SceneError: the file is missing or is no image.
    """
    from PIL import Image

    with decoding("the image", path, _FIX), Image.open(path) as file:
        return upright_size(file) if upright else file.size


def upright_size(file: Image.Image) -> Size:
    """`(width, height)` of a photograph turned as its EXIF orientation says."""
    width, height = file.size
    return (
        (height, width) if file.getexif().get(_ORIENTATION) in _QUARTER_TURNS else (width, height)
    )


def divided_by(divisor: int) -> Callable[[int, int], Size]:
    """Each side divided and rounded, as the published protocols do."""
    return lambda width, height: (
        max(1, round(width / divisor)),
        max(1, round(height / divisor)),
    )


def at_most(largest: int) -> Callable[[int, int], Size]:
    """At most `largest` pixels wide, in proportion; nothing is enlarged."""

    def size(width: int, height: int) -> Size:
        if width <= largest:
            return width, height
        return largest, max(1, round(height * largest / width))

    return size


def longest_side(largest: int) -> Callable[[int, int], Size]:
    """The longer side at most `largest` pixels, in proportion; nothing is enlarged."""

    def size(width: int, height: int) -> Size:
        scale = min(1.0, largest / max(width, height))
        return max(1, round(width * scale)), max(1, round(height * scale))

    return size


def in_parallel(work: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """`work` done to each item, in order, on as many threads as there are cores.

    Pillow and numpy let go of the interpreter's lock while they work.
    """
    with ThreadPoolExecutor(max(1, min(len(items), os.cpu_count() or 1))) as pool:
        return list(pool.map(work, items))


def find_image(path: Path) -> Path:
    """The file, or the one image of the same name with another ending.

    Raises:
        SceneError: there is none.
    """
    if path.is_file():
        return path
    for suffix in IMAGE_SUFFIXES:
        for spelling in (suffix, suffix.upper()):
            other = path.with_name(path.stem + spelling)
            if other.is_file():
                return other
    raise SceneError(
        "a photograph is missing",
        where=str(path),
        fix="restore it, or choose views that are there",
    )


def list_images(folder: Path) -> list[Path]:
    """The image files in a folder, sorted by name; none if there is no such folder."""
    if not folder.is_dir():
        return []
    return sorted(path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES)


def _check_mode(file: Image.Image, path: Path) -> None:
    if file.mode not in _MODES:
        raise SceneError(
            f"the image has pixels of kind {file.mode!r}, not 8 bits a channel",
            where=str(path),
            fix=_FIX,
        )
