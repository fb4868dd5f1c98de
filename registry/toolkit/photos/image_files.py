"""Find image files in a scene's folder."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...errors import SceneError

if TYPE_CHECKING:
    from pathlib import Path

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".bmp")
"""Suffixes of files that are read as photographs, in lower case."""
HEIF_SUFFIXES = (".heic", ".heif")
"""Suffixes of HEIC files, the format of phones, in lower case; see `read_heif`."""


def find_image(path: Path) -> Path:
    """Return the file, or the image of the same name with another suffix.

    Raises:
        SceneError: Neither exists.
    """
    found = existing_image(path)
    if found is not None:
        return found
    raise SceneError(
        "a photograph is missing", where=str(path), fix="restore it, or choose other views"
    )


def existing_image(path: Path) -> Path | None:
    """Return the file that `find_image` finds, or None."""
    if path.is_file():
        return path
    for suffix in IMAGE_SUFFIXES:
        for spelling in (suffix, suffix.upper()):
            other = path.with_name(path.stem + spelling)
            if other.is_file():
                return other
    return None


def list_images(folder: Path) -> list[Path]:
    """Return the image files of a folder, sorted by name; an empty list if the folder is missing."""
    if not folder.is_dir():
        return []
    return sorted(path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES)


def read_heif() -> bool:
    """Register the HEIC decoder of pillow-heif with Pillow; return False if it is not installed."""
    try:
        import pillow_heif
    except ImportError:
        return False
    pillow_heif.register_heif_opener()
    return True
