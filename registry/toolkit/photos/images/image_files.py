"""Which files are photographs, and where one lies that a camera file names."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ....errors import SceneError

if TYPE_CHECKING:
    from pathlib import Path

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".bmp")
"""Endings of the files that are read as photographs, in lower case."""


def find_image(path: Path) -> Path:
    """The file, or the one image of the same name with another ending.

    Raises:
        SceneError: there is none.
    """
    found = existing_image(path)
    if found is not None:
        return found
    raise SceneError(
        "a photograph is missing",
        where=str(path),
        fix="restore it, or choose views that are there",
    )


def existing_image(path: Path) -> Path | None:
    """What `find_image` finds, or None."""
    if path.is_file():
        return path
    for suffix in IMAGE_SUFFIXES:
        for spelling in (suffix, suffix.upper()):
            other = path.with_name(path.stem + spelling)
            if other.is_file():
                return other
    return None


def list_images(folder: Path) -> list[Path]:
    """The image files in a folder, sorted by name; none if there is no such folder."""
    if not folder.is_dir():
        return []
    return sorted(path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES)
