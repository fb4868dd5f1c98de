"""Resized photographs on disk, found again by the content of the large file.

    STEREOGS_CACHE/photographs/<key>.png    lossless; deleting any of it is safe

The key is a hash over the file's bytes, the treatment and Pillow's version.
"""

from __future__ import annotations

import hashlib
import logging
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from PIL import Image

_log = logging.getLogger(__name__)


def remembered(path: Path, treatment: str, compute: Callable[[], Image.Image]) -> Image.Image:
    """The image that `compute` makes of the file at `path`, from the cache if it is there.

    Args:
        treatment: all that the result depends on beside the file.
    """
    import PIL
    from PIL import Image

    from registry import cache_folder

    folder = cache_folder("photographs")
    if folder is None:
        return compute()
    content = path.read_bytes() + f"\0{treatment}\0{PIL.__version__}".encode()
    kept = folder / f"{hashlib.sha256(content).hexdigest()[:32]}.png"
    if kept.is_file():
        try:
            with Image.open(kept) as file:
                return file.convert("RGB")
        except (OSError, SyntaxError) as error:
            _log.warning("the cached photograph %s is damaged (%s); resizing anew", kept, error)
    image = compute()
    _keep(image, kept)
    return image


def _keep(image: Image.Image, path: Path) -> None:
    """Write all or nothing. A full or read-only disk is reported; loading goes on without."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=".partial") as folder:
            image.save(Path(folder, path.name), compress_level=1)
            Path(folder, path.name).replace(path)
    except OSError as error:
        _log.warning("the resized photograph could not be cached: %s", error)
