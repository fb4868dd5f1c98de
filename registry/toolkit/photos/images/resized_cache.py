"""Resized photographs on disk, found again by the content of the large file.

    STEREOGS_CACHE/photographs/<key>/image.png    lossless

The key is a hash over the file's bytes, the treatment and Pillow's version.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...cache import Cache, content_key

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from PIL import Image

_FILE = "image.png"


def remembered(path: Path, treatment: str, compute: Callable[[], Image.Image]) -> Image.Image:
    """The image that `compute` makes of the file at `path`, from the cache if it is there.

    Args:
        treatment: all that the result depends on beside the file.
    """
    import PIL

    kept = Cache("photographs")
    if kept.folder is None:
        return compute()
    key = content_key(path.read_bytes(), treatment, PIL.__version__)
    image = kept.load(key, _read)
    if image is None:
        image = compute()
        kept.save(key, lambda folder: image.save(folder / _FILE, compress_level=1))
    return image


def _read(folder: Path) -> Image.Image:
    from PIL import Image

    with Image.open(folder / _FILE, formats=("PNG",)) as file:
        return file.copy()
