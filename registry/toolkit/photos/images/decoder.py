"""Decoding photographs: on one background, at one size.

A decoded photograph is 8-bit RGB until the end, as the published protocols resize it. Resized
photographs are kept on disk: decoding 16 megapixels anew for every run costs some thirty times as much
as reading the small result.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, TypeAlias

from ....errors import SceneError
from .opening import IMAGE_FIX, open_image
from .resized_cache import remembered

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray
    from PIL import Image

    from .sizes import Size, SizeRule

Pixels: TypeAlias = "NDArray[np.uint8]"
"""`[H, W, 3]`, or `[H, W]` of one brightness."""
ResizeFilter = Literal["box", "bilinear", "bicubic", "lanczos"]
"""Pillow's filter of that name; each averages over the area when it reduces."""
BACKGROUNDS = {"white": (1.0, 1.0, 1.0), "black": (0.0, 0.0, 0.0)}
"""Colours in [0, 1] that transparent pixels are laid on, by name."""

_ORIENTATION = 0x0112
_QUARTER_TURNS = (5, 6, 7, 8)
"""Values of that EXIF tag that exchange width and height."""
_MODES = ("1", "L", "LA", "P", "PA", "RGB", "RGBA", "CMYK", "YCbCr")


@dataclass(frozen=True)
class Decoder:
    """How photographs are read.

    Args:
        size: `(width, height)` wanted of a photograph that is stored as `(width, height)`.
        resize_filter: what it is resized with.
        background: colour, in [0, 1], that transparent pixels are laid on.
        upright: turn photographs as their EXIF orientation says. Camera files of data sets speak of
            pixels as they are stored.
    """

    size: SizeRule = lambda width, height: (width, height)
    resize_filter: ResizeFilter = "bicubic"
    background: tuple[float, float, float] = BACKGROUNDS["black"]
    upright: bool = False

    def read(self, path: Path) -> Pixels:
        """`[H, W, 3]` uint8.

        Raises:
            SceneError: what `open_image` refuses, or more than 8 bits a channel.
        """
        import numpy as np

        with open_image(path) as file:
            _check_mode(file, path)
            return np.asarray(self._resized(file, path, self._opaque, str(self.background)))

    def read_alpha(self, path: Path) -> Pixels | None:
        """`[H, W]` uint8, how much each pixel of that picture covers; None if it is opaque.

        Raises:
            SceneError: as `read`.
        """
        import numpy as np

        with open_image(path) as file:
            _check_mode(file, path)
            if not file.has_transparency_data:
                return None
            return np.asarray(self._resized(file, path, _alpha, "alpha"))

    def _resized(
        self,
        file: Image.Image,
        path: Path,
        select: Callable[[Image.Image], Image.Image],
        selection: str,
    ) -> Image.Image:
        """What `select` takes from a photograph, upright and at the size that is wanted.

        Args:
            selection: what the answer of `select` depends on beside the file.
        """
        from PIL import Image, ImageOps

        stored = upright_size(file) if self.upright else file.size
        size = self.size(*stored)

        def selected() -> Image.Image:
            return select(ImageOps.exif_transpose(file) if self.upright else file)

        if size == stored:
            return selected()
        resample = Image.Resampling[self.resize_filter.upper()]
        treatment = f"{size} {self.resize_filter} {selection} {self.upright}"
        return remembered(path, treatment, lambda: selected().resize(size, resample))

    def _opaque(self, file: Image.Image) -> Image.Image:
        from PIL import Image

        if not file.has_transparency_data:
            return file.convert("RGB")
        color = tuple(round(255 * channel) for channel in self.background)
        below = Image.new("RGBA", file.size, (*color, 255))
        below.alpha_composite(file.convert("RGBA"))
        return below.convert("RGB")


def _alpha(file: Image.Image) -> Image.Image:
    return file.convert("RGBA").getchannel("A")


def read_mask(path: Path, size: Size) -> Pixels:
    """`[H, W]` uint8 brightness of a mask, resized with the bicubic filter if it has another size.

    Raises:
        SceneError: what `open_image` refuses, or more than 8 bits a channel.
    """
    import numpy as np
    from PIL import Image

    with open_image(path, "the mask") as file:
        _check_mode(file, path)
        grey = file.convert("L")
        return np.asarray(
            grey if grey.size == size else grey.resize(size, Image.Resampling.BICUBIC)
        )


def stored_size(path: Path, *, upright: bool = False) -> Size:
    """`(width, height)` of an image file, turned as its EXIF orientation says if `upright`.

    Raises:
        SceneError: what `open_image` refuses.
    """
    with open_image(path) as file:
        return upright_size(file) if upright else file.size


def upright_size(file: Image.Image) -> Size:
    """`(width, height)` of a photograph turned as its EXIF orientation says."""
    width, height = file.size
    return (
        (height, width) if file.getexif().get(_ORIENTATION) in _QUARTER_TURNS else (width, height)
    )


def _check_mode(file: Image.Image, path: Path) -> None:
    if file.mode not in _MODES:
        raise SceneError(
            f"the image has pixels of kind {file.mode!r}, not 8 bits a channel",
            where=str(path),
            fix=IMAGE_FIX,
        )
